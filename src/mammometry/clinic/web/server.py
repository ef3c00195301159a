"""The server's process, which runs uvicorn and the application, and the runner's process."""

import errno
import logging
import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

import mammometry
from mammometry.base.child_process import CallError, ChildProcess
from mammometry.base.machine.cores import available_cores
from mammometry.clinic.config import ClinicConfig, ClinicError, host_and_port, read_config
from mammometry.clinic.site import application
from mammometry.hospital.peers import is_loopback
from mammometry.web.server import server

_AGAIN_S = 5.0  # pause before a helper process that has ended is started again
_END_S = 15.0  # time for a runner to return its jobs to the queue
_LOG = logging.getLogger(__name__)


def migrate(config: ClinicConfig) -> list[str]:
    """Upgrade the database's tables to this version. Return the applied migrations.

    Each migration is one transaction, so a killed one has no effect, and the same command continues.
    """
    from django.core.management import call_command
    from django.db import connection
    from django.db.migrations.executor import MigrationExecutor

    from mammometry.clinic.site import configure

    configure(config)
    executor = MigrationExecutor(connection)
    waiting = [
        f"{migration.app_label} {migration.name}"
        for migration, _ in executor.migration_plan(executor.loader.graph.leaf_nodes())
    ]
    call_command("migrate", interactive=False, verbosity=0)
    from mammometry.clinic import audit_chain

    audit_chain.extend()
    if config.database == "sqlite":
        for path in config.folder.glob("clinic.sqlite3*"):
            path.chmod(0o600)
    return waiting


def require_current(config: ClinicConfig) -> None:
    """Refuse a database of another version, or one whose audit could be changed.

    Raises:
        ClinicError: migrations are missing, the database is newer, or the audit's triggers are missing.
    """
    from django.db import OperationalError, connection
    from django.db.migrations.executor import MigrationExecutor

    from mammometry.clinic import audit
    from mammometry.clinic.site import configure

    configure(config)
    try:
        executor = MigrationExecutor(connection)
    except OperationalError as error:
        raise ClinicError(
            "the database", found=f"no answer ({type(error).__name__})", expected="a database that answers",
            remedy="Start it, or correct the line database in clinic.toml",
        ) from None  # fmt: skip
    unknown = [key for key in executor.loader.applied_migrations if key not in executor.loader.disk_migrations]
    if unknown:
        raise ClinicError(
            "the database", found="tables of another version of mammometry",
            expected=f"those of this version, {mammometry.__version__}",
            remedy="Serve the clinic with the version that was used last",
        )  # fmt: skip
    if executor.migration_plan(executor.loader.graph.leaf_nodes()):
        remedy = f"Make a backup with that version, then run `mammometry clinic upgrade {config.folder}`"
        expected = "those of this version"
        raise ClinicError("the database", found="tables of an older version", expected=expected, remedy=remedy)
    if not audit.is_sealed():
        raise ClinicError(
            "the audit", found="missing or different triggers for refusing changes", expected="ours in the database",
            remedy=f"Find out who removed them, then run `mammometry clinic upgrade {config.folder}`",
        )  # fmt: skip


def serve(config: ClinicConfig, *, jobs: bool = True) -> None:
    """Serve the clinic until a signal ends it.

    Args:
        config: the clinic's.
        jobs: whether to run jobs, too, in a second process.

    Raises:
        ClinicError: other machines could reach it without encryption, or a file of the certificate is missing.
    """
    from django.core.management import call_command

    host, port = host_and_port(config.address)
    tls = config.tls
    if not tls.certificate and not is_loopback(host):
        remedy = "Give --tls-certificate and --tls-key, or listen on 127.0.0.1 behind a proxy that speaks TLS"
        expected = "encryption, because other machines can reach it"
        raise ClinicError(f"address {config.address}", found="no certificate", expected=expected, remedy=remedy)
    for name in filter(None, (tls.certificate, tls.key)):
        if not Path(name).is_file():
            raise ClinicError(name, found="no file", expected="a PEM file", remedy="Correct [tls] in clinic.toml")
    require_current(config)
    call_command("clearsessions")  # deletes expired sessions
    with beside(work, config.folder) if jobs else nullcontext(), suppress(KeyboardInterrupt):
        server(
            application(config),
            request_s=config.limits.request_s,
            host=host,
            port=port,
            ssl_certfile=tls.certificate or None,
            ssl_keyfile=tls.key or None,
            proxy_headers=tls.behind_proxy,
            forwarded_allow_ips="127.0.0.1,::1",
        ).run()


def work(folder: Path) -> None:
    """Run the queue of a clinic in this process until a signal ends it."""
    from mammometry.clinic.site import configure

    config = read_config(folder)
    configure(config)
    from mammometry.clinic.intake.uploads import remove_stale_locks
    from mammometry.clinic.jobs.lanes import LANES
    from mammometry.clinic.jobs.runner import Runner
    from mammometry.clinic.maintenance.backups import remove_leftovers

    remove_leftovers(config)
    remove_stale_locks()
    runner = Runner(config, lanes=LANES)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: runner.stop())
    runner.run()


@contextmanager
def beside(task: Callable[[Path], None], folder: Path, *, again: bool = True) -> Iterator[None]:
    """Run another process while the server runs.

    Args:
        task: function that the process runs.
        folder: the clinic's folder, the argument of `task`.
        again: whether to restart the process if it ends.
    """
    ended = threading.Event()
    processes: list[subprocess.Popen[bytes]] = []

    def keep() -> None:
        while not ended.is_set():
            with ChildProcess(cores=available_cores()) as child, suppress(CallError):
                processes[:] = [child.process]
                child.call(task, folder)
            if not again:
                return
            if not ended.is_set():
                _LOG.warning("The runner ended and is being restarted.")
                ended.wait(_AGAIN_S)

    keeper = threading.Thread(target=keep, daemon=True)
    keeper.start()
    try:
        yield
    finally:
        ended.set()
        for process in processes:
            process.terminate()  # a runner returns its jobs to the queue
        keeper.join(_END_S)
        for process in processes:
            process.kill()


def require_free(address: str) -> None:
    """Refuse an address on which the server cannot listen, before anything is started.

    Raises:
        ClinicError: another program listens there, the port is reserved, or the host is not an address of this machine.
    """
    host, port = host_and_port(address)
    remedy = "Name another address with --address HOST:PORT, or in clinic.toml"
    try:
        if port > 65535:
            raise OSError(errno.EADDRNOTAVAIL, "no such port")  # bind would raise OverflowError
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(
                socket.SOL_SOCKET, socket.SO_REUSEADDR, 1
            )  # as the server does: closed connections do not count
            probe.bind(place)
    except OSError as error:
        found = "an address or port that does not exist on this machine"
        if error.errno == errno.EADDRINUSE:
            found = "another program that listens there"
            remedy = f"Stop that program, perhaps another server of this clinic. Or: {remedy[0].lower()}{remedy[1:]}"
        elif error.errno == errno.EACCES:
            found = "a port reserved for the system"
        expected = "an address on which the clinic can listen"
        raise ClinicError(f"address {address}", found=found, expected=expected, remedy=remedy) from None
