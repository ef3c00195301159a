"""What a worker offers reaches tasks that waited for it."""

import dask
import pytest
from distributed import Client, LocalCluster

from mammometry.batch.record import CORES, MEMORY
from mammometry.batch.worker_resources import WorkerResources, memory_mb


@pytest.mark.slow
def test_a_task_that_no_worker_could_take_is_given_to_one_that_comes_later():
    """A worker offers its memory only after it has joined, when Dask has already looked at what waits."""
    nothing = {"distributed.worker.memory.terminate": False}
    quiet = {"processes": True, "dashboard_address": "127.0.0.1:0", "memory_limit": 0, "threads_per_worker": 2}
    with (
        dask.config.set(nothing),
        LocalCluster(n_workers=0, host="127.0.0.1", **quiet) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        client.register_plugin(WorkerResources())
        waiting = client.submit(abs, -3, resources={CORES: 1, MEMORY: memory_mb()})
        cluster.scale(1)
        assert waiting.result(timeout=20) == 3
