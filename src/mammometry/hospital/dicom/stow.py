"""Send a study by STOW-RS (PS3.18), nothing twice."""

import json
import ssl
import urllib.error
import urllib.request
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pydicom import Dataset

from mammometry.base.errors import ArchiveError
from mammometry.base.progress import Progress, no_progress
from mammometry.hospital.codes import uid
from mammometry.hospital.dicom.frame import encoded
from mammometry.hospital.dicom.store import Sent
from mammometry.hospital.peers import AUTHORIZATION, PeerTls, require_encrypted, web_address

_ANSWER_S = 120.0  # wait for an answer, s; long enough for archives that index before they answer
_MOST_ANSWER = 16 << 20  # bytes of an answer
_LOGIN = f"Give its login: {AUTHORIZATION} for the command line, [stow_secrets] in a clinic's clinic.toml"
_FULL = (507, 413)  # HTTP: insufficient storage, content too large


def stow(
    made: Sequence[Dataset],
    url: str,
    *,
    tls: PeerTls | None = None,
    authorization: str | None = None,
    progress: Progress = no_progress,
) -> Sent:
    """Send objects of one study, one request each.

    Args:
        made: finished objects.
        url: of the archive's DICOMweb service, such as ``https://pacs/dicom-web``.
        tls: certificates. None: those that the system trusts.
        authorization: the HTTP header, such as ``Bearer …``. None: no login.
        progress: called with the fraction sent.

    Raises:
        SettingsError: an invalid address, or one that would send a login unencrypted.
        ArchiveError: it does not answer, refuses, is full, or the connection is lost. The same call sends the rest.
    """
    service = _service(url, tls, authorization)
    stored = _there(service, made[0].StudyInstanceUID)
    missing = [dataset for dataset in made if dataset.SOPInstanceUID not in stored]
    for number, dataset in enumerate(missing):
        _store(service, dataset, f"after {number} of {len(missing)} objects")
        progress((number + 1) / len(missing))
    return Sent(sent=len(missing), stored=len(made) - len(missing))


def answers(url: str, *, tls: PeerTls | None = None, authorization: str | None = None) -> None:
    """Check that a DICOMweb service answers, by a search that finds nothing.

    Raises:
        SettingsError: an invalid address, or one that would send a login unencrypted.
        ArchiveError: it does not answer, or refuses.
    """
    _there(_service(url, tls, authorization), "2.25.0")


@dataclass(frozen=True, slots=True)
class _Service:
    """A DICOMweb service and its connection."""

    base: str
    context: ssl.SSLContext | None
    authorization: str | None


def _service(url: str, tls: PeerTls | None, authorization: str | None) -> _Service:
    base = web_address(url)
    if authorization:
        require_encrypted(base)
    return _Service(base, None if tls is None else tls.context(), authorization)


def _there(service: _Service, study: str) -> set[str]:
    """Objects of the study that the archive has, by QIDO-RS."""
    base = service.base
    query = f"studies/{study}/instances?includefield=00080018"
    try:
        answer = _answer(service, query, {"Accept": "application/dicom+json"})
    except urllib.error.HTTPError as error:
        if error.code in (404, 204, 501, 405):  # no such study, or no searches
            return set()
        raise _refused(base, error, "before the first object") from None
    except OSError as error:
        raise _silent(base, error, "before the first object") from None
    if not answer.strip():
        return set()
    try:
        listed = json.loads(answer)
        return {str(instance["00080018"]["Value"][0]) for instance in listed}
    except (ValueError, KeyError, TypeError, IndexError):
        remedy = "Check the address, without /studies"
        expected = "a DICOMweb service"
        raise ArchiveError(base, found="an answer that is not DICOM JSON", expected=expected, remedy=remedy) from None


def _store(service: _Service, made: Dataset, when: str) -> None:
    base = service.base
    boundary = uid("boundary", made.SOPInstanceUID)
    head = f"--{boundary}\r\nContent-Type: application/dicom\r\n\r\n".encode()
    body = head + encoded(made) + f"\r\n--{boundary}--\r\n".encode()
    kind = f'multipart/related; type="application/dicom"; boundary={boundary}'
    try:
        answer = _answer(service, "studies", {"Content-Type": kind, "Accept": "application/dicom+json"}, body)
    except urllib.error.HTTPError as error:
        raise _refused(base, error, when) from None
    except OSError as error:
        raise _silent(base, error, when) from None
    failed = _failed(answer)
    # A full Orthanc answers 200, with an object neither among the stored nor among the refused ones.
    if failed or (not _listed(answer, made) and made.SOPInstanceUID not in _there(service, made.StudyInstanceUID)):
        raise ArchiveError(
            base,
            found=f"a refused object {when} ({failed or 'not stored, without a reason'}, {made.SOPClassUID.name})",
            expected="an archive that stores it",
            remedy=(
                "Ask its administrator why, and whether it is full. Then run the same command again: stored objects "
                "are not sent again"
            ),
        )


def _failed(answer: bytes) -> str:
    """The reason if the answer's Failed SOP Sequence (0008,1198) is not empty."""
    items = _items(answer, "00081198")
    return f"reason {items[0].get('00081197', {}).get('Value', ['unknown'])[0]}" if items else ""


def _listed(answer: bytes, made: Dataset) -> bool:
    """Whether the answer's Referenced SOP Sequence (0008,1199) has the object, so that it is stored."""
    stored = [item.get("00081155", {}).get("Value") for item in _items(answer, "00081199")]
    return [str(made.SOPInstanceUID)] in stored


def _items(answer: bytes, sequence: str) -> list[dict[str, Any]]:
    """Items of a sequence of an answer. Empty for an answer that is not DICOM JSON."""
    try:
        items = json.loads(answer)[sequence].get("Value") or []
        return [instance for instance in items if isinstance(instance, dict)]
    except (ValueError, AttributeError, TypeError, KeyError):
        return []


def _answer(service: _Service, place: str, headers: dict[str, str], body: bytes | None = None) -> bytes:
    if service.authorization:
        headers = {**headers, "Authorization": service.authorization}
    method = "POST" if body is not None else "GET"
    request = urllib.request.Request(f"{service.base}/{place}", data=body, headers=headers, method=method)
    handlers: list[urllib.request.BaseHandler] = [_NoRedirect()]
    if service.context is not None:
        handlers.append(urllib.request.HTTPSHandler(context=service.context))
    with urllib.request.build_opener(*handlers).open(request, timeout=_ANSWER_S) as answer:
        return bytes(answer.read(_MOST_ANSWER))


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Refuse redirections: patients' data are sent only to the given address."""

    def redirect_request(self, *_: Any, **__: Any) -> None:
        return None


def _refused(base: str, error: urllib.error.HTTPError, when: str) -> ArchiveError:
    full = error.code in _FULL
    login = error.code in (401, 403)
    remedy = (
        "Have space freed there" if full else _LOGIN if login else "Ask its administrator why"
    )  # fmt: skip
    return ArchiveError(
        base,
        found=f"{'a full archive' if full else 'a refusal'} {when} (HTTP {error.code})",
        expected="an archive that stores objects",
        remedy=f"{remedy}. Then run the same command again: stored objects are not sent again",
    )


def _silent(base: str, error: OSError, when: str) -> ArchiveError:
    why = getattr(error, "reason", error)
    return ArchiveError(
        base,
        found=f"no answer, {when} ({why})",
        expected="a DICOMweb service",
        remedy=(
            "Check the address and whether it is running. Then run the same command again: stored objects are not "
            "sent again"
        ),
    )
