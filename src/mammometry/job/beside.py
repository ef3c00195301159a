"""What no later stage needs is made beside the next one."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager

from mammometry.base.machine.cores import available_cores
from mammometry.job.products import Products


class Beside:
    """Makes stages, and leaves their late products to another thread."""

    def __init__(self, pool: Executor | None) -> None:
        """Without a pool, all is made in order."""
        self._pool = pool
        self._begun: list[Future[None]] = []

    def ensure(self, stage: Products) -> None:
        """Make what the memo lacks of a stage. Its late products may be made afterwards."""
        self._begun += stage.ensure(self._pool)

    def wait(self) -> None:
        """Wait for what was left. Raises what stood in its way."""
        while self._begun:
            self._begun.pop().result()


@contextmanager
def beside_the_next_stage() -> Iterator[Beside]:
    """Have a thread for late products, where there is a second core.

    Nothing new is begun there once the block has failed.
    """
    if available_cores() < 2:
        yield Beside(None)
        return
    with ThreadPoolExecutor(1) as pool:
        try:
            yield Beside(pool)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
