"""Send a study by C-STORE, nothing twice, and wait for the storage commitment."""

from collections import defaultdict
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from threading import Event
from typing import Any

from pydicom import Dataset
from pydicom.sequence import Sequence as Items
from pynetdicom import AE, evt
from pynetdicom.sop_class import StorageCommitmentPushModel, StudyRootQueryRetrieveInformationModelFind  # type: ignore[attr-defined]  # made at run time

from mammometry.base.errors import ArchiveError, NotOfferedError
from mammometry.base.progress import Progress, no_progress
from mammometry.hospital.codes import uid
from mammometry.hospital.dicom.association import OWN_TITLE, accepts, associated, comment, found_by, lost
from mammometry.hospital.peers import Peer, PeerTls

_FULL = range(0xA700, 0xA800)  # PS3.4, B.2.3: out of resources
_WARNINGS = range(0xB000, 0xC000)  # stored, with a warning


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """Result of sending a study."""

    sent: int
    """Objects that were sent now."""
    stored: int
    """Objects that the archive already had."""


def send(
    made: Sequence[Dataset],
    peer: Peer,
    *,
    own_title: str = OWN_TITLE,
    tls: PeerTls | None = None,
    progress: Progress = no_progress,
) -> Sent:
    """Send objects of one study.

    Args:
        made: finished objects.
        peer: the archive.
        own_title: our AE title.
        tls: encryption. None: none.
        progress: called with the fraction sent.

    Raises:
        ArchiveError: it does not answer, refuses, is full, or the connection is lost. The same call sends the rest.
    """
    wanted = [(StudyRootQueryRetrieveInformationModelFind, None)]
    syntaxes: dict[str, set[str]] = defaultdict(set)
    for dataset in made:
        syntaxes[dataset.SOPClassUID].add(dataset.file_meta.TransferSyntaxUID)
    # One context each, so that the archive cannot choose among several transfer syntaxes.
    contexts = [*wanted, *((sop_class, [syntax]) for sop_class, all_ in syntaxes.items() for syntax in sorted(all_))]
    with associated(peer, contexts, own_title=own_title, tls=tls) as association:
        _require_all(association, made, peer)
        stored = _there(association, made, peer)
        missing = [dataset for dataset in made if dataset.SOPInstanceUID not in stored]
        for number, dataset in enumerate(missing):
            _store(association, dataset, peer, f"after {number} of {len(missing)} objects")
            progress((number + 1) / len(missing))
    return Sent(sent=len(missing), stored=len(made) - len(missing))


def _require_all(association: Any, made: Sequence[Dataset], peer: Peer) -> None:
    """Refuse before the first object is sent, so that no study is incomplete."""
    taken = {(context.abstract_syntax, context.transfer_syntax[0]) for context in association.accepted_contexts}
    refused = sorted(
        {
            f"{dataset.SOPClassUID.name} ({dataset.file_meta.TransferSyntaxUID.name})"
            for dataset in made
            if (dataset.SOPClassUID, dataset.file_meta.TransferSyntaxUID) not in taken
        }
    )
    if refused:
        remedy = "Ask its administrator to allow them, or leave them out by --without"
        expected = "one that accepts all kinds of object"
        raise ArchiveError(
            str(peer), found=f"an archive that does not accept {', '.join(refused)}", expected=expected, remedy=remedy
        )


def _there(association: Any, made: Sequence[Dataset], peer: Peer) -> set[str]:
    """Objects that the archive has, or none if it does not answer searches."""
    if not accepts(association, StudyRootQueryRetrieveInformationModelFind):
        return set()
    stored: set[str] = set()
    for series in sorted({dataset.SeriesInstanceUID for dataset in made}):
        query = Dataset()
        query.QueryRetrieveLevel = "IMAGE"
        query.StudyInstanceUID = made[0].StudyInstanceUID
        query.SeriesInstanceUID = series
        query.SOPInstanceUID = ""
        answers = found_by(association, query, StudyRootQueryRetrieveInformationModelFind, peer)
        stored |= {str(answer.SOPInstanceUID) for answer in answers if answer and "SOPInstanceUID" in answer}
    return stored


def _store(association: Any, made: Dataset, peer: Peer, when: str) -> None:
    try:
        status = association.send_c_store(made)
    except RuntimeError:  # the association ended in between
        raise lost(peer, when) from None
    code = status.get("Status")
    if code is None:
        raise lost(peer, when)
    if code == 0 or code in _WARNINGS:
        return
    full = code in _FULL
    raise ArchiveError(
        str(peer),
        found=f"{'a full archive' if full else 'a refused object'} {when} "
        f"(status {code:04X}{comment(status)}, {made.SOPClassUID.name})",
        expected="an archive that stores it",
        remedy=f"{'Have space freed there' if full else 'Ask its administrator why'}. Then run the same command again: "
        "stored objects are not sent again",
    )


_WELL_KNOWN = "1.2.840.10008.1.20.1.1"  # Storage Commitment Push Model SOP Instance
_REQUEST = 1  # action type of PS3.4, J.3.2
_ANSWER_S = 60.0  # an archive may check its disks first


def committed(
    made: Sequence[Dataset],
    peer: Peer,
    *,
    own_title: str = OWN_TITLE,
    tls: PeerTls | None = None,
    listen: int | None = None,
    answer_s: float = _ANSWER_S,
) -> bool | None:
    """Request storage commitment, and wait for the answer.

    Args:
        made: the sent objects.
        peer: the archive.
        own_title: our AE title.
        tls: encryption. None: none.
        listen: port for its answer. None: it answers on our own connection, or not at all.
        answer_s: how long to wait, s.

    Returns:
        Whether it keeps all of them. None if it does not support this, or did not answer in time.

    Raises:
        ArchiveError: it refused the request, or does not keep all objects.
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
        except NotOfferedError:
            return None
        status, _ = association.send_n_action(
            _question(made, transaction), _REQUEST, StorageCommitmentPushModel, _WELL_KNOWN
        )
        if status.get("Status") != 0:
            code = f"status {status.get('Status', 0):04X}{comment(status)}"
            remedy = "Ask its administrator to allow us storage commitment, or leave --commitment out"
            expected = "a storage commitment"
            raise ArchiveError(
                str(peer), found=f"a refused request for storage commitment ({code})", expected=expected, remedy=remedy
            )
        if not replied.wait(answer_s):
            return None
    if failed:
        raise ArchiveError(
            str(peer),
            found=f"an archive that does not keep {len(failed)} of {len(made)} objects",
            expected="a storage commitment for all of them",
            remedy="Run the same command again, and ask its administrator if this repeats",
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


def _listening(port: int, own_title: str, tls: PeerTls | None, handlers: list[Any]) -> Any:
    """A server for the archive's answer, which comes on a separate connection."""
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
            found=f"a port that cannot be opened ({error.strerror})",
            expected="a free port for the archive's answer",
            remedy="Choose another one by --listen",
        ) from None
