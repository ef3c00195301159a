"""A visit's report with what the database knows of it.

It is rendered when somebody asks for it, and not stored.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mammometry.base.errors import SessionError
from mammometry.clinic.models import Visit
from mammometry.clinic.records.clinical_facts import clinical_of
from mammometry.clinic.records.confirmations import CHANGED, is_changed
from mammometry.clinic.site import the_clinic

if TYPE_CHECKING:
    from mammometry.api.job import Job
    from mammometry.api.mesh import MeshJob
    from mammometry.report.documents.rendering import RenderedReport


def measured_job(visit: Visit) -> Job | MeshJob:
    """Open a visit whose newest boundaries and landmarks are measured.

    Raises:
        SessionError: it was changed since, or would have to be measured again.
        MammometryError: its folder cannot be opened.
    """
    from mammometry.api.job import open_session
    from mammometry.api.mesh import MeshJob, scan_files

    if is_changed(visit):
        raise SessionError(
            str(visit), found=CHANGED, expected="a visit whose newest boundaries and landmarks are measured",
            remedy="Wait until it is measured, or measure it",
        )  # fmt: skip
    settings = the_clinic().measuring()
    job: Job | MeshJob = (
        MeshJob(scan_files(visit.folder), visit.folder / "results", settings)
        if visit.is_scan
        else open_session(visit.folder, settings)
    )
    if not job.store.has(job.content_key):
        raise SessionError(
            str(visit), found="a visit whose report is not current", expected="a measured visit",
            remedy="Measure it again",
        )  # fmt: skip
    return job


def rendered_report(visit: Visit) -> RenderedReport:
    """The report with names, operations, confirmation and conclusions.

    Raises:
        MammometryError: as of `measured_job`.
    """
    return measured_job(visit).rendered(clinical_of(visit))
