"""Send results to archives. Each delivery is a job of the queue."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from django.db import transaction
from django.utils import timezone

from mammometry.base.extras import MissingLibraryError, missing
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Delivery, Destination, Job, Patient, Person, Visit, VisitOrder
from mammometry.clinic.records.clinical import clinical_of, operation_words, operations_before
from mammometry.clinic.records.results import measured_job
from mammometry.clinic.site import the_clinic
from mammometry.hospital.exported import Exported, ExportedOperation, Order, plain_name
from mammometry.hospital.exported import ExportedPatient as PatientModule
from mammometry.hospital.peers import Peer, PeerTls
from mammometry.report.content import Clinical

_LIBRARIES = ("pydicom", "pynetdicom", "highdicom")


def require_libraries(*modules: str) -> None:
    """Refuse if a library is not installed, with a message for the clinic's users.

    Raises:
        MissingLibraryError: names it.
    """
    if absent := missing(*modules):
        raise MissingLibraryError(
            "this clinic's server", found=f"no library {', '.join(absent)}", expected="all libraries for exports",
            remedy="Ask the administrator to install mammometry with its extra \"clinic\"",
        )  # fmt: skip


def enqueue(visit: Visit, destination: Destination, person: Person | None) -> Delivery:
    """Queue a visit's results for sending. A delivery that is not finished is not queued twice."""
    pending = visit.deliveries.filter(destination=destination, state=Delivery.State.QUEUED).first()
    if pending is not None:
        return pending
    with transaction.atomic():
        delivery = Delivery.objects.create(visit=visit, destination=destination, created_by=person)
        queue.enqueue(delivery, person)
    return delivery


def test(destination: Destination) -> None:
    """Check that an archive answers: by C-ECHO, or by a search of its web service.

    Raises:
        MammometryError: it does not.
    """
    require_libraries(*_LIBRARIES)
    if destination.kind != Destination.Kind.STOW:
        from mammometry.hospital.dicom.association import echo

        echo(Peer.parse(destination.address), own_title=destination.own_title, tls=tls_of(destination))
    else:
        from mammometry.hospital.dicom.stow import answers

        secret = the_clinic().stow_secret(destination.address)
        answers(destination.address, tls=tls_of(destination), authorization=secret)


def send(config: ClinicConfig, job: Job) -> dict[str, Any]:
    """Send a visit's results, as a job of the queue.

    Returns:
        ``sent``: number of objects; ``kept``: whether the archive has committed to store all; ``message``.

    Raises:
        MammometryError: the visit is not measured, or the archive refuses the results.
    """
    assert job.delivery is not None
    visit, destination = job.delivery.visit, job.delivery.destination
    sent, kept = _send(config, visit, destination)
    wanted = destination.commitment and destination.kind == Destination.Kind.DICOM
    return {"sent": sent, "kept": kept, "message": "It sent no storage commitment." if wanted and not kept else ""}


def patient_module(patient: Patient) -> PatientModule:
    """The patient's identification for DICOM, as in the hospital's systems."""
    name = f"{plain_name(patient.family_name)}^{plain_name(patient.given_name)}"
    return PatientModule(id=patient.record_number, name=name, born=patient.born)


def gathered(config: ClinicConfig, visit: Visit, *, whole: bool = True, deidentify: bool = False) -> Exported:
    """Gather what a visit's exports contain.

    Args:
        config: the clinic's.
        visit: measured.
        whole: include report, models and photographs; otherwise numbers only.
        deidentify: for recipients outside the clinic: without pseudonym, dates and photographs.

    Raises:
        MammometryError: the visit is not measured, has changed since, or must be measured again.
    """
    from mammometry.hospital.gather import PARTS, gather

    job, parts = measured_job(visit), PARTS if whole else ()
    clinical = Clinical() if deidentify else clinical_of(visit)
    taken = timezone.localtime(visit.taken_at).date()
    exported = gather(job, taken=taken, clinical=clinical, deidentify=deidentify, parts=parts)
    if deidentify:
        return exported
    conclusion, measurement = visit.conclusions.first(), visit.measurements.first()
    concluded = conclusion is not None and measurement is not None and conclusion.measurement_id == measurement.pk
    is_final = concluded and clinical.confirmed is not None
    return replace(exported, operations=_operations(visit), organization=config.name, is_final=is_final)


def _operations(visit: Visit) -> tuple[ExportedOperation, ...]:
    """Operations before the visit, newest first."""
    return tuple(
        ExportedOperation(
            kind=row.kind, title=str(row.get_kind_display()), side=row.side, day=row.day,
            sentence=operation_words(row),
        )
        for row in operations_before(visit)
    )  # fmt: skip


def study_of(config: ClinicConfig, visit: Visit, *, deidentify: bool = False) -> dict[str, bytes]:
    """A visit's DICOM objects: file name → content.

    Args:
        config: the clinic's.
        visit: measured.
        deidentify: for recipients outside the clinic; see `gathered`.

    Raises:
        MammometryError: it is not measured, or a library is missing.
    """
    require_libraries(*_LIBRARIES)
    from mammometry.hospital.dicom.objects import files, objects

    return files(
        objects(gathered(config, visit, deidentify=deidentify), patient_module(visit.patient), order_of(visit))
    )


def order_of(visit: Visit) -> Order:
    """Order of a visit. Empty if it is not from a worklist."""
    order = VisitOrder.objects.filter(visit=visit).first()
    if order is None:
        return Order()
    return Order(
        accession=order.accession, study_uid=order.study_uid, referring=order.referring,
        procedure_id=order.procedure_id, procedure=order.procedure,
    )  # fmt: skip


def connection(destination: Destination) -> tuple[Peer, PeerTls | None]:
    """Address of a DICOM application, and the connection's encryption."""
    return Peer.parse(destination.address), tls_of(destination)


def _send(config: ClinicConfig, visit: Visit, destination: Destination) -> tuple[int, bool | None]:
    """Number of sent objects, and whether the archive committed to store all."""
    require_libraries(*_LIBRARIES)
    from mammometry.hospital.dicom.objects import objects
    from mammometry.hospital.dicom.store import committed, send
    from mammometry.hospital.dicom.stow import stow

    made = objects(gathered(config, visit), patient_module(visit.patient), order_of(visit))
    if destination.kind == Destination.Kind.STOW:
        secret = config.stow_secret(destination.address)
        return stow(made, destination.address, tls=tls_of(destination), authorization=secret).sent, None
    (peer, tls), own_title = connection(destination), destination.own_title
    sent = send(made, peer, own_title=own_title, tls=tls).sent
    if not destination.commitment:
        return sent, None
    return sent, committed(made, peer, own_title=own_title, tls=tls, listen=destination.promise_port)


def tls_of(destination: Destination) -> PeerTls | None:
    """Encryption of the connection to an archive. None if unencrypted."""
    if not destination.encrypted:
        return None
    files = (
        Path(name) if name else None for name in (destination.authorities, destination.certificate, destination.key)
    )
    authorities, certificate, key = files
    return PeerTls(authorities=authorities, certificate=certificate, key=key)
