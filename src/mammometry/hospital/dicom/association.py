"""A connection to another DICOM application."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

from pydicom import Dataset
from pynetdicom import AE, evt

from mammometry.base.errors import ArchiveError, NotOfferedError
from mammometry.hospital.peers import Peer, PeerTls

OWN_TITLE = "MAMMOMETRY"
_CONNECT_S = 10.0  # for the connection and its negotiation
_ANSWER_S = 60.0  # for one answer; an archive may write to slow disks
_PENDING = (0xFF00, 0xFF01)  # status of an answer with more to follow (PS3.4, C.4.1.1.4)


@contextmanager
def associated(
    peer: Peer,
    contexts: Sequence[tuple[str, Sequence[str] | None]],
    *,
    own_title: str = OWN_TITLE,
    tls: PeerTls | None = None,
    handlers: Sequence[Any] = (),
) -> Iterator[Any]:
    """Open an association, and release it at the end.

    Args:
        peer: the other application.
        contexts: SOP classes, each with its transfer syntaxes (None for the usual ones).
        own_title: our AE title.
        tls: encryption. None: none.
        handlers: of pynetdicom's events.

    Raises:
        ArchiveError: no answer, or we are refused.
    """
    ae = AE(ae_title=own_title)
    ae.acse_timeout = ae.connection_timeout = _CONNECT_S
    ae.dimse_timeout = ae.network_timeout = _ANSWER_S
    for sop_class, syntaxes in contexts:
        if syntaxes is None:
            ae.add_requested_context(sop_class)
        else:
            ae.add_requested_context(sop_class, list(syntaxes))
    with ExitStack() as opened:  # pynetdicom leaves a socket open if the other side has closed it
        closes = (evt.EVT_CONN_OPEN, lambda event: opened.callback(event.assoc.dul.socket.socket.close))
        association = ae.associate(
            peer.host,
            peer.port,
            ae_title=peer.title,
            tls_args=None if tls is None else (tls.context(), peer.host),
            evt_handlers=[closes, *handlers],
        )
        if not association.is_established:
            raise _refused(peer, association, own_title, encrypted=tls is not None)
        try:
            yield association
        finally:
            if association.is_established:
                association.release()


def accepts(association: Any, sop_class: str) -> bool:
    """Whether the other side accepted a service."""
    return any(context.abstract_syntax == sop_class for context in association.accepted_contexts)


def found_by(association: Any, query: Dataset, model: str, peer: Peer) -> list[Dataset]:
    """All answers to a C-FIND.

    Raises:
        ArchiveError: the search was refused, or the connection was lost.
    """
    answers = []
    for status, answer in association.send_c_find(query, model):
        code = status.get("Status")
        if code is None:
            raise lost(peer, "during a search")
        if code in _PENDING:
            answers.append(answer)
        elif code != 0:
            raise ArchiveError(
                str(peer),
                found=f"a refused search (status {code:04X}{comment(status)})",
                expected="an answer",
                remedy="Ask its administrator for our permissions",
            )
    return answers


def lost(peer: Peer, when: str) -> ArchiveError:
    """The error for a connection that ended too soon."""
    remedy = "Run the same command again: stored objects are not sent again"
    return ArchiveError(str(peer), found=f"a connection that ended {when}", expected="an answer", remedy=remedy)


def echo(peer: Peer, *, own_title: str = OWN_TITLE, tls: PeerTls | None = None) -> None:
    """Check that a DICOM application answers (C-ECHO).

    Raises:
        ArchiveError: it does not.
    """
    from pynetdicom.sop_class import Verification  # type: ignore[attr-defined]  # made at run time

    with associated(peer, [(Verification, None)], own_title=own_title, tls=tls) as association:
        status = association.send_c_echo()
        if status.get("Status") != 0:
            raise lost(peer, "before it answered a C-ECHO")


def comment(status: Dataset) -> str:
    """The other side's comment on a status, for a message."""
    error_comment = status.get("ErrorComment", "")
    return f": {error_comment}" if error_comment else ""


def _refused(peer: Peer, association: Any, own_title: str, *, encrypted: bool) -> ArchiveError:
    if association.is_rejected:
        answer = association.acceptor.primitive
        why = "" if answer is None else f" ({answer.reason_str})"
        remedy = "Ask its administrator to enter our AE title, and check its own"
        return ArchiveError(
            str(peer), found=f"an application that refuses {own_title}{why}", expected="to be accepted", remedy=remedy
        )
    if association.acceptor.primitive is not None:
        return NotOfferedError(
            str(peer),
            found="an application that offers none of the services asked for",
            expected="storage, or the search that was asked for",
            remedy="Ask its administrator which services it allows us",
        )
    remedy = "Check host and port, whether it is running, and whether it needs TLS. Then run the same command again"
    expected = "a DICOM application" + (", with TLS" if encrypted else "")
    return ArchiveError(str(peer), found="no answer", expected=expected, remedy=remedy)
