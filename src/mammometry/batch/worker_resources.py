"""Plugin that offers a worker's cores and memory to tasks.

Dask installs it on every worker, including later ones.
"""

import psutil
from distributed import Status, Worker, WorkerPlugin
from distributed.system import MEMORY_LIMIT

from mammometry.batch.record import CORES, MEMORY

_SHARE = 0.85
"""Share of a machine's memory for the tasks. The rest is for the system and the disk."""
_MIB = 1 << 20  # bytes in a MiB


class WorkerResources(WorkerPlugin):  # type: ignore[misc]  # half of distributed is typed
    """Offer the worker's threads as cores, and its machine's memory.

    A worker that was started with an offer keeps it. Start one worker per machine, with as many threads as it has
    cores.
    """

    name = "mammometry-offer"

    async def setup(self, worker: Worker) -> None:
        """Report this to the scheduler."""
        resources = worker.state.total_resources
        await worker.set_resources(
            **{CORES: resources.get(CORES, float(worker.state.nthreads)), MEMORY: resources.get(MEMORY, memory_mb())}
        )
        # Dask reconsiders a task that fits no worker only when a worker joins, which was before this offer, or resumes
        # after a pause.
        if worker.status is Status.running:
            worker.status = Status.paused
            worker.status = Status.running


def memory_mb() -> float:
    """Memory of this machine for tasks, MB, or the smaller limit of its control group."""
    return float(round(_SHARE * min(psutil.virtual_memory().total, MEMORY_LIMIT) / _MIB))
