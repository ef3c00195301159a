"""What a worker offers to tasks, whoever started it: a plugin that Dask gives to every worker, also to later ones."""

from __future__ import annotations

import psutil
from distributed import Worker, WorkerPlugin
from distributed.system import MEMORY_LIMIT

from mammometry.batch.names import CORES, MEMORY

_SHARE = 0.85
"""Of a machine's memory for the tasks. The rest is the system's and the disk's."""
_MIB = 1 << 20


class Offer(WorkerPlugin):  # type: ignore[misc]  # half of distributed is typed
    """Offer the worker's threads as cores, and its machine's memory, unless the worker was started with an offer.

    A machine's workers are taken to be one: start one worker a machine, with as many threads as it has cores.
    """

    name = "mammometry-offer"

    async def setup(self, worker: Worker) -> None:
        """Say so to the scheduler."""
        there = worker.state.total_resources
        await worker.set_resources(
            **{CORES: there.get(CORES, float(worker.state.nthreads)), MEMORY: there.get(MEMORY, memory_mb())}
        )


def memory_mb() -> float:
    """Memory of this machine for tasks, MB.

    Less where the system's control group allows less.
    """
    return float(round(_SHARE * min(psutil.virtual_memory().total, MEMORY_LIMIT) / _MIB))
