"""The runner as a process: beside the server, or by itself.

Its standard input stays open as long as the server lives. When that ends, even by force, the runner ends, and Dask's
worker and its tasks with it: nothing goes on unseen.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mammometry.base.machine.system import own_group
from mammometry.clinic.config import ClinicConfig, read_config

_END_S = 15.0  # for a runner to give its jobs back
_AGAIN_S = 5.0  # until one that died is started again
_LOG = logging.getLogger(__name__)


def run_here(config: ClinicConfig) -> None:
    """Serve the queue in this process until a signal ends it."""
    from mammometry.clinic.site import configure

    configure(config)
    from mammometry.clinic.deliveries import Deliverer
    from mammometry.clinic.jobs.runner import Runner
    from mammometry.clinic.maintenance.backups import DailyBackup

    Deliverer(config).start()
    DailyBackup(config).start()
    runner = Runner(config)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: runner.stop())
    runner.run()


@contextmanager
def beside(config: ClinicConfig, module: str = __spec__.name, *, again: bool = True) -> Iterator[None]:
    """Keep a process at work beside the server, by default a runner.

    Args:
        config: the clinic's.
        module: what it runs, with the clinic's folder as its argument. It calls `end_with_input`.
        again: start it again when it has ended.
    """
    ended = threading.Event()
    processes: list[subprocess.Popen[bytes]] = []

    def keep() -> None:
        while not ended.is_set():
            process = subprocess.Popen(
                [sys.executable, "-m", module, str(config.folder)],
                stdin=subprocess.PIPE,
                **own_group(),  # Ctrl-C at the terminal is the server's to answer
            )
            processes[:] = [process]
            process.wait()
            if not again:
                return
            if not ended.is_set():
                _LOG.warning("The runner ended with code %s and is started again.", process.returncode)
                ended.wait(_AGAIN_S)

    keeper = threading.Thread(target=keep, daemon=True)
    keeper.start()
    try:
        yield
    finally:
        ended.set()
        for process in processes:
            process.terminate()
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
        keeper.join(_END_S)


def main() -> None:
    """Serve one clinic's queue until standard input ends."""
    end_with_input()
    run_here(read_config(Path(sys.argv[1])))


def end_with_input() -> None:
    """End this process, by force, when its standard input ends."""
    threading.Thread(target=_wait_for_end, daemon=True).start()


def _wait_for_end() -> None:
    sys.stdin.buffer.read()
    os._exit(1)  # the server is gone: leases end by themselves, and this process's are seen to be a dead one's


if __name__ == "__main__":
    main()
