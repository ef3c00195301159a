"""Jobs that a runner does in its own process.

These are deliveries, backups, restore tests, and chaining the audit.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mammometry.base.child_process import Call, ChildProcess
from mammometry.clinic.audit_chain import extend
from mammometry.clinic.config import ClinicConfig, ClinicError
from mammometry.clinic.deliveries import send
from mammometry.clinic.maintenance.backups import make_kept_backup, plan_daily
from mammometry.clinic.maintenance.restore import run_restore_test
from mammometry.clinic.models import Job


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """Kinds of jobs that are done one after another, and the functions that do them."""

    name: str
    work: Mapping[str, Callable[[ClinicConfig, Job], Mapping[str, Any]]]
    """Kind → function that does a job and returns the argument of `results.enter`."""
    plan: Callable[[ClinicConfig], object] = lambda _: None
    """Queues scheduled jobs. Called every few seconds while no job waits."""


def backup(config: ClinicConfig, _: Job) -> dict[str, Any]:
    """Make a backup, and delete the oldest.

    Raises:
        ClinicError: the disk is too full, or another backup is being made.
    """
    make_kept_backup(config)
    return {}


def restore_test(config: ClinicConfig, _: Job) -> dict[str, Any]:
    """Test a restore in a separate process, since a process can open only one clinic.

    Raises:
        ClinicError: the test failed.
    """
    with ChildProcess() as child:
        answer = child.answer(Call(function=run_restore_test, arguments=(config,)))
    if why := answer.get("failed") or answer.get("killed"):
        raise ClinicError("the restore test", found=why, expected="the clinic as it was", remedy="Make another backup")
    return {}


LANES = (
    Lane(name="deliveries", work={Job.Kind.SEND: send}),
    Lane(name="audit", work={}, plan=lambda _: extend(every=False)),
    Lane(name="upkeep", work={Job.Kind.BACKUP: backup, Job.Kind.RESTORE: restore_test}, plan=plan_daily),
)
"""The lanes of a clinic's server."""
