"""Machines of a batch: this one's cores, or an existing Dask cluster."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mammometry.base.errors import BatchError
from mammometry.base.extras import require
from mammometry.base.machine.cores import available_cores
from mammometry.batch.record import CORES, MEMORY

if TYPE_CHECKING:
    from distributed import Client

_ANSWER_S = 15.0  # for a scheduler to answer, and for its first worker to be there
_DASK = {
    "distributed.worker.memory.target": False,  # tasks' answers are small, and we watch their processes ourselves
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": False,
    "distributed.scheduler.worker-saturation": 1.0,  # no task waits at a worker for its turn
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Machines:
    """Workers, and what they offer."""

    client: Client
    local: bool
    """Whether they were started for this batch, on this machine."""
    dashboard: str | None
    """Address of Dask's own pages, where they are served."""

    def count(self) -> int:
        """Workers there are now."""
        return len(self.client.scheduler_info(n_workers=-1)["workers"])

    def largest(self) -> dict[str, float]:
        """Resource → what the worker offers that offers most of it. Empty while there is no worker."""
        most: dict[str, float] = {}
        for offers in self._offers():
            for resource, offer in offers.items():
                most[resource] = max(offer, most.get(resource, 0.0))
        return most

    def cores(self) -> int:
        """Cores that all workers offer together."""
        return int(sum(offers.get(CORES, 0.0) for offers in self._offers()))

    def _offers(self) -> list[dict[str, float]]:
        workers = self.client.sync(self.client.scheduler.identity, n_workers=-1)["workers"]
        return [about["resources"] for about in workers.values()]


@contextmanager
def machines(scheduler: str | None, cores: int | None = None, memory_mb: float | None = None) -> Iterator[Machines]:
    """Start a worker on this machine, or connect to a cluster's scheduler.

    Args:
        scheduler: its address, ``tcp://host:8786``; None: this machine.
        cores: of this machine that tasks take together; None: all.
        memory_mb: that tasks take together on this machine; None: nearly all.

    Raises:
        MissingLibraryError: Dask is not installed.
        BatchError: the scheduler does not answer, has no worker, or one without mammometry or with another version.
    """
    require("batch", "distributed")
    import dask
    from distributed import Client, LocalCluster

    from mammometry.batch.worker_resources import WorkerResources

    for name in ("distributed", *(name for name in logging.root.manager.loggerDict if name.startswith("distributed."))):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters of it we say ourselves

    with dask.config.set(_DASK):
        if scheduler is not None:
            with _connected(scheduler) as client:
                _require_same(client, scheduler)
                client.register_plugin(WorkerResources())
                yield Machines(client=client, local=False, dashboard=client.dashboard_link)
            return
        threads = cores or available_cores()
        resources = {CORES: float(threads)} | ({MEMORY: float(memory_mb)} if memory_mb else {})
        pages = importlib.util.find_spec("bokeh") is not None
        with (
            LocalCluster(
                n_workers=1,
                threads_per_worker=threads,
                processes=True,
                memory_limit=0,
                resources=resources,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                silence_logs=50,
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            client.register_plugin(WorkerResources())
            yield Machines(client=client, local=True, dashboard=client.dashboard_link if pages else None)


@contextmanager
def _connected(scheduler: str) -> Iterator[Client]:
    from distributed import Client

    try:
        client = Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).partition("\n")[0]
        remedy = "Start one with `dask scheduler`, or leave --scheduler out to use this machine"
        expected = "the address of a Dask scheduler, such as tcp://host:8786"
        raise BatchError(
            scheduler, found=f"no scheduler that answers ({reason})", expected=expected, remedy=remedy
        ) from None
    try:
        yield client
    finally:
        client.close(timeout=_ANSWER_S)


def _require_same(client: Client, scheduler: str) -> None:
    """Refuse workers that would come to other results. Later ones are asked with their first task."""
    try:
        client.wait_for_workers(1, timeout=_ANSWER_S)
    except TimeoutError:
        remedy = f"Start some with `dask worker {scheduler} --nthreads N`, N being the machine's cores"
        expected = "at least one worker"
        raise BatchError(scheduler, found="a scheduler without any worker", expected=expected, remedy=remedy) from None
    ours = importlib.metadata.version("mammometry")
    # A function of the standard library: a worker without mammometry can run no other.
    versions = client.run(importlib.metadata.version, "mammometry", on_error="return")
    for address, theirs in versions.items():
        if theirs != ours:
            raise other_version(
                address, "no mammometry" if isinstance(theirs, Exception) else f"mammometry version {theirs}", ours
            )


def other_version(worker: str, found: str, ours: str) -> BatchError:
    """Say that a worker's software is not ours."""
    return BatchError(
        f"worker {worker}",
        found=found,
        expected=f"mammometry {ours}, as on this machine",
        remedy="Install the same version there and start the worker again",
    )
