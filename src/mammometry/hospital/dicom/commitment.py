"""Storage commitment: an archive's promise to keep what was sent (PS3.4, J)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from threading import Event
from typing import Any

from pydicom import Dataset
from pydicom.sequence import Sequence as Items
from pynetdicom import AE, evt
from pynetdicom.sop_class import StorageCommitmentPushModel  # type: ignore[attr-defined]  # made at run time

from mammometry.base.errors import ArchiveError
from mammometry.hospital.dicom.association import OWN_TITLE, associated, comment
from mammometry.hospital.identifiers import uid
from mammometry.hospital.peers import Peer, Tls

_WELL_KNOWN = "1.2.840.10008.1.20.1.1"  # Storage Commitment Push Model SOP Instance
_REQUEST = 1  # action type of PS3.4, J.3.2
_ANSWER_S = 60.0  # an archive may look at its disks first


def committed(
    made: Sequence[Dataset],
    peer: Peer,
    *,
    own_title: str = OWN_TITLE,
    tls: Tls | None = None,
    listen: int | None = None,
    answer_s: float = _ANSWER_S,
) -> bool | None:
    """Ask an archive to keep objects, and await its answer.

    Args:
        made: what was sent.
        peer: the archive.
        own_title: AE title by which it knows us.
        tls: how the connection is encrypted. None: not.
        listen: port to which it sends its answer. None: it answers on our own connection, or not at all.
        answer_s: how long to wait, s.

    Returns:
        Whether it keeps all of them. None where it offers no such promise, or did not answer in time.

    Raises:
        ArchiveError: it refused the question, or does not keep all objects.
    """
    replied, failed = Event(), list[str]()
    transaction = uid("commitment", *sorted(dataset.SOPInstanceUID for dataset in made))

    def on_report(event: Any) -> tuple[int, None]:
        report = event.event_information
        if str(report.get("TransactionUID", "")) == transaction:
            failed.extend(str(item.ReferencedSOPInstanceUID) for item in report.get("FailedSOPSequence", ()))
            replied.set()
        return 0x0000, None

    handlers = [(evt.EVT_N_EVENT_REPORT, on_report)]
    with ExitStack() as stack:
        if listen is not None:
            stack.callback(_listening(listen, own_title, tls, handlers).shutdown)
        try:
            association = stack.enter_context(
                associated(peer, [(StorageCommitmentPushModel, None)], own_title=own_title, tls=tls, handlers=handlers)
            )
        except ArchiveError as error:
            if "offers none" in error.found:
                return None
            raise
        status, _ = association.send_n_action(
            _question(made, transaction), _REQUEST, StorageCommitmentPushModel, _WELL_KNOWN
        )
        if status.get("Status") != 0:
            code = f"status {status.get('Status', 0):04X}{comment(status)}"
            raise ArchiveError(
                str(peer),
                found=f"a refused request for storage commitment ({code})",
                expected="the promise to keep what was sent",
                remedy="Ask its administrator to allow us storage commitment, or leave --commitment out",
            )
        if not replied.wait(answer_s):
            return None
    if failed:
        raise ArchiveError(
            str(peer),
            found=f"an archive that does not keep {len(failed)} of {len(made)} objects",
            expected="the promise to keep all of them",
            remedy="Run the same command again, and ask its administrator if it stays so",
        )
    return True


def _question(made: Sequence[Dataset], transaction: str) -> Dataset:
    question = Dataset()
    question.TransactionUID = transaction
    items = []
    for dataset in made:
        item = Dataset()
        item.ReferencedSOPClassUID, item.ReferencedSOPInstanceUID = dataset.SOPClassUID, dataset.SOPInstanceUID
        items.append(item)
    question.ReferencedSOPSequence = Items(items)
    return question


def _listening(port: int, own_title: str, tls: Tls | None, handlers: list[Any]) -> Any:
    """A server for the archive's answer, which comes on a connection of its own."""
    import ssl

    ae = AE(ae_title=own_title)
    ae.add_supported_context(StorageCommitmentPushModel, scu_role=True, scp_role=True)
    context = None
    if tls is not None and tls.certificate is not None:
        context = ssl.create_default_context(
            ssl.Purpose.CLIENT_AUTH, cafile=None if tls.authorities is None else str(tls.authorities)
        )
        context.load_cert_chain(tls.certificate, tls.key)
    try:
        return ae.start_server(("", port), block=False, evt_handlers=handlers, ssl_context=context)
    except OSError as error:
        raise ArchiveError(
            f"port {port}",
            found=f"a port that cannot be listened on ({error.strerror})",
            expected="a free port for the archive's answer",
            remedy="Choose another one by --listen",
        ) from None
