"""Results to archives. A queue whose rows are tried again, later each time."""

import datetime
import logging
import threading
from dataclasses import replace
from pathlib import Path

from django.db import DatabaseError, close_old_connections
from django.db.models import F
from django.utils import timezone

from mammometry.base.errors import MammometryError
from mammometry.base.extras import MissingLibraryError, missing
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.models import Delivery, Destination, Patient, Person, Visit, VisitOrder
from mammometry.clinic.records.clinical import clinical_of, operation_words, operations_before
from mammometry.clinic.records.results import measured_job
from mammometry.clinic.site import the_clinic
from mammometry.hospital.exported import Exported, Operation, Order, plain_name
from mammometry.hospital.exported import Patient as PatientModule
from mammometry.hospital.peers import Peer, Tls
from mammometry.report.content import Clinical

MOST_TRIES = 8  # with the waits below, for four hours
_FIRST_WAIT = datetime.timedelta(minutes=1)
_LONGEST_WAIT = datetime.timedelta(hours=1)
_LEASE = datetime.timedelta(minutes=30)  # longer than a whole study takes on a slow line
_LOOK_S = 5.0  # between two looks into the queue
_LOG = logging.getLogger(__name__)
_LIBRARIES = ("pydicom", "pynetdicom", "highdicom")


def require_libraries(*modules: str) -> None:
    """Refuse where a library is not installed, in words for people who cannot install it.

    Raises:
        MissingLibraryError: names it.
    """
    if absent := missing(*modules):
        raise MissingLibraryError(
            "this clinic's server", found=f"no library {', '.join(absent)}", expected="all that exports need",
            remedy="Ask the administrator to install mammometry with its extra \"clinic\"",
        )  # fmt: skip


def enqueue(visit: Visit, destination: Destination, person: Person | None) -> Delivery:
    """Have a visit's results sent. One that is on its way already is not sent twice."""
    waiting = (Delivery.State.QUEUED, Delivery.State.SENDING)
    pending = visit.deliveries.filter(destination=destination, state__in=waiting).first()
    if pending is not None:
        return pending
    return Delivery.objects.create(visit=visit, destination=destination, created_by=person, next_try=timezone.now())


def again(delivery: Delivery) -> None:
    """Try a failed delivery again."""
    Delivery.objects.filter(pk=delivery.pk, state=Delivery.State.FAILED).update(
        state=Delivery.State.QUEUED, tries=0, next_try=timezone.now(), message=""
    )


def test(destination: Destination) -> None:
    """Ask an archive whether it answers. C-ECHO, or a search of its web service.

    Raises:
        MammometryError: it does not, in one sentence.
    """
    require_libraries(*_LIBRARIES)
    if destination.kind != Destination.Kind.STOW:
        from mammometry.hospital.dicom.association import echo

        echo(Peer.parse(destination.address), own_title=destination.own_title, tls=tls_of(destination))
    else:
        from mammometry.hospital.dicom.stow import answers

        secret = the_clinic().stow_secret(destination.address)
        answers(destination.address, tls=tls_of(destination), authorization=secret)


def claim() -> Delivery | None:
    """Take the next one that is due. Also from somebody who died while sending."""
    now = timezone.now()
    waiting = (Delivery.State.QUEUED, Delivery.State.SENDING)
    rows = Delivery.objects.filter(state__in=waiting, next_try__lte=now, visit__binned_at=None)
    given_up = rows.filter(state=Delivery.State.SENDING, tries__gte=MOST_TRIES)
    given_up.update(state=Delivery.State.FAILED, message="The clinic's server ended while it was sent.", ended=now)
    for due in rows.order_by("next_try")[:20]:
        # Whoever changes the row first has it.
        taken = Delivery.objects.filter(pk=due.pk, state=due.state, next_try=due.next_try).update(
            state=Delivery.State.SENDING, next_try=now + _LEASE, tries=F("tries") + 1
        )
        if taken:
            return Delivery.objects.select_related("visit__patient", "destination").get(pk=due.pk)
    return None


def deliver(config: ClinicConfig, delivery: Delivery) -> None:
    """Send a claimed delivery, and write down what came of it."""
    lease = delivery.next_try
    mine = Delivery.objects.filter(pk=delivery.pk, state=Delivery.State.SENDING, next_try=lease)
    try:
        sent, kept = _send(config, delivery)
    except DatabaseError:
        raise
    except Exception as error:  # from a library: unknown failures end as well
        if isinstance(error, MammometryError):
            words = str(error).replace(f"{config.folder}/", "")[:1500]
        else:
            _LOG.exception("A delivery was not sent")
            words = f"An unknown reason ({type(error).__name__}), which is in the clinic's log."
        last = delivery.tries >= MOST_TRIES
        wait = min(_FIRST_WAIT * 2 ** (delivery.tries - 1), _LONGEST_WAIT)
        mine.update(
            state=Delivery.State.FAILED if last else Delivery.State.QUEUED,
            next_try=timezone.now() + wait,
            message=words,
            ended=timezone.now() if last else None,
        )
        return
    commitment_wanted = delivery.destination.commitment and delivery.destination.kind == Destination.Kind.DICOM
    message = "It gave no promise to keep them." if commitment_wanted and not kept else ""
    mine.update(state=Delivery.State.SENT, sent=F("sent") + sent, kept=kept, message=message, ended=timezone.now())


def patient_module(patient: Patient) -> PatientModule:
    """A patient as the hospital's systems call him or her."""
    name = f"{plain_name(patient.family_name)}^{plain_name(patient.given_name)}"
    return PatientModule(id=patient.record_number, name=name, born=patient.born)


def gathered(config: ClinicConfig, visit: Visit, *, whole: bool = True, deidentify: bool = False) -> Exported:
    """Exported content of a visit.

    Args:
        config: the clinic's.
        visit: measured.
        whole: with report, models and photographs; else numbers alone.
        deidentify: for others: no pseudonym, no dates, no photographs.

    Raises:
        MammometryError: it is not measured, was changed since, or would have to be measured again.
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


def _operations(visit: Visit) -> tuple[Operation, ...]:
    """Operations before the visit, the newest first."""
    return tuple(
        Operation(
            kind=row.kind, title=str(row.get_kind_display()), side=row.side, day=row.day,
            sentence=operation_words(row),
        )
        for row in operations_before(visit)
    )  # fmt: skip


def study_of(config: ClinicConfig, visit: Visit, *, deidentify: bool = False) -> dict[str, bytes]:
    """A visit's DICOM objects: name of a file → its content.

    Args:
        config: the clinic's.
        visit: measured.
        deidentify: for others; see `gathered`.

    Raises:
        MammometryError: it is not measured, or a library is missing.
    """
    require_libraries(*_LIBRARIES)
    from mammometry.hospital.dicom.objects import files, objects

    return files(
        objects(gathered(config, visit, deidentify=deidentify), patient_module(visit.patient), order_of(visit))
    )


def order_of(visit: Visit) -> Order:
    """A visit's order. Empty where it did not come from a worklist."""
    order = VisitOrder.objects.filter(visit=visit).first()
    if order is None:
        return Order()
    return Order(
        accession=order.accession, study_uid=order.study_uid, referring=order.referring,
        procedure_id=order.procedure_id, procedure=order.procedure,
    )  # fmt: skip


class Deliverer(threading.Thread):
    """Sends what is due, until it is stopped."""

    def __init__(self, config: ClinicConfig) -> None:
        super().__init__(daemon=True, name="deliveries")
        self._config = config
        self._stopped = threading.Event()

    def stop(self) -> None:
        """End after the delivery at hand."""
        self._stopped.set()

    def run(self) -> None:
        """Serve the queue. A database that is gone is waited for."""
        while not self._stopped.is_set():
            try:
                due = claim()
                if due is not None:
                    deliver(self._config, due)
                    continue
            except DatabaseError as error:
                _LOG.warning("Deliveries wait: %s", type(error).__name__)
            except Exception:  # one that cannot be sent does not stop the others: its lease ends
                _LOG.exception("A delivery was not sent")
            close_old_connections()
            self._stopped.wait(_LOOK_S)


def connection(destination: Destination) -> tuple[Peer, Tls | None]:
    """Address of a DICOM application, and the encryption of the connection."""
    return Peer.parse(destination.address), tls_of(destination)


def _send(config: ClinicConfig, delivery: Delivery) -> tuple[int, bool | None]:
    """Objects that were sent; whether the archive promised to keep all."""
    require_libraries(*_LIBRARIES)
    from mammometry.hospital.dicom.objects import objects
    from mammometry.hospital.dicom.store import committed, send
    from mammometry.hospital.dicom.stow import stow

    visit, destination = delivery.visit, delivery.destination
    made = objects(gathered(config, visit), patient_module(visit.patient), order_of(visit))
    if destination.kind == Destination.Kind.STOW:
        secret = config.stow_secret(destination.address)
        return stow(made, destination.address, tls=tls_of(destination), authorization=secret).sent, None
    (peer, tls), own_title = connection(destination), destination.own_title
    sent = send(made, peer, own_title=own_title, tls=tls).sent
    if not destination.commitment:
        return sent, None
    return sent, committed(made, peer, own_title=own_title, tls=tls, listen=destination.promise_port)


def tls_of(destination: Destination) -> Tls | None:
    """Encryption of the connection to an archive. None: not encrypted."""
    if not destination.encrypted:
        return None
    files = (
        Path(name) if name else None for name in (destination.authorities, destination.certificate, destination.key)
    )
    authorities, certificate, key = files
    return Tls(authorities=authorities, certificate=certificate, key=key)
