"""Sending to archives: a real Orthanc where one is installed, and archives that refuse, are full or die."""

import datetime
import shutil
import ssl
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pydicom import Dataset, dcmread
from pydicom.filebase import DicomBytesIO
from pydicom.sequence import Sequence
from pynetdicom import AE, evt
from tests import orthanc
from tests.unit.hospital.exports import ANNA, ORDER, exported

from mammometry.base.errors import ArchiveError, SettingsError
from mammometry.hospital.dicom.association import echo
from mammometry.hospital.dicom.frame import encoded
from mammometry.hospital.dicom.objects import objects
from mammometry.hospital.dicom.store import committed, send
from mammometry.hospital.dicom.stow import stow
from mammometry.hospital.dicom.worklist import entries, only_entry
from mammometry.hospital.peers import Peer, PeerTls, web_address

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("orthanc"),
    # Sockets of servers in other threads are closed when they are collected.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
ORTHANC = pytest.mark.skipif(orthanc.program() is None, reason=orthanc.ABSENT)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> list[Dataset]:
    return objects(exported(tmp_path_factory.mktemp("session")), ANNA, ORDER)


def content(there: bytes) -> bytes:
    """A file without its header, in which each archive names itself."""
    file = DicomBytesIO(there)
    dcmread(file, stop_before_pixels=True, specific_tags=[])
    length = int.from_bytes(there[140:144], "little")
    return there[144 + length :]


# --- a real archive ---


@ORTHANC
def test_stored_found_and_fetched_unchanged(made: list[Dataset], tmp_path: Path) -> None:
    with orthanc.server(tmp_path / "orthanc") as archive:
        peer = Peer.parse(archive.peer)
        echo(peer)
        first, again = send(made, peer), send(made, peer)
        assert (first.sent, first.stored, again.sent, again.stored) == (len(made), 0, 0, len(made))
        there = archive.instances()
        assert {name: content(each) for name, each in there.items()} == {
            each.SOPInstanceUID: content(encoded(each)) for each in made
        }
        assert stow(made, archive.web).sent == 0


@ORTHANC
def test_stow_stores_the_very_bytes(made: list[Dataset], tmp_path: Path) -> None:
    with orthanc.server(tmp_path / "orthanc") as archive:
        assert stow(made, archive.web).sent == len(made)
        assert stow(made, archive.web).sent == 0
        assert send(made, Peer.parse(archive.peer)).sent == 0
        assert archive.instances() == {each.SOPInstanceUID: encoded(each) for each in made}


@ORTHANC
@pytest.mark.parametrize("way", ["C-STORE", "STOW"])
def test_an_archive_that_dies_half_way_gets_the_rest_later(made: list[Dataset], tmp_path: Path, way: str) -> None:
    with orthanc.server(tmp_path / "orthanc") as archive:

        def die(fraction: float) -> None:
            if fraction >= 0.4 and archive.running is not None:
                archive.stop(kill=True)

        def deliver(progress: Any = lambda fraction: None) -> Any:
            if way == "STOW":
                return stow(made, archive.web, progress=progress)
            return send(made, Peer.parse(archive.peer), progress=progress)

        with pytest.raises(ArchiveError, match=r"after 5 of 12 objects.*[Rr]un"):
            deliver(die)
        with pytest.raises(ArchiveError, match="answers"):
            deliver()
        archive.start()
        came = deliver()
        assert came.stored >= 3  # what it had not yet written when it was killed is sent again
        assert came.sent + came.stored == len(made)
        assert set(archive.instances()) == {each.SOPInstanceUID for each in made}


@ORTHANC
@pytest.mark.parametrize("way", ["C-STORE", "STOW"])
def test_an_archive_whose_disk_is_full_gets_the_rest_later(made: list[Dataset], tmp_path: Path, way: str) -> None:
    with orthanc.server(tmp_path / "orthanc") as archive:

        def deliver(progress: Any = lambda fraction: None) -> Any:
            if way == "STOW":
                return stow(made, archive.web, progress=progress)
            return send(made, Peer.parse(archive.peer), progress=progress)

        def full(fraction: float) -> None:
            if fraction >= 0.4:
                archive.fill(0)

        with pytest.raises(ArchiveError, match="of 12 objects"):
            deliver(full)
        archive.fill(None)
        came = deliver()
        assert came.sent > 0
        assert came.sent + came.stored == len(made)
        assert set(archive.instances()) == {each.SOPInstanceUID for each in made}


@ORTHANC
def test_an_archive_with_another_title_refuses(made: list[Dataset], tmp_path: Path) -> None:
    with orthanc.server(tmp_path / "orthanc") as archive:
        wrong = Peer(title="ELSEWHERE", host="127.0.0.1", port=archive.dicom)
        with pytest.raises(ArchiveError, match="refuses MAMMOMETRY"):
            send(made, wrong)
        assert archive.instances() == {}


@ORTHANC
def test_an_archive_promises_to_keep_the_objects(made: list[Dataset], tmp_path: Path) -> None:
    port = orthanc.free_port()
    modalities = {"us": ["MAMMOMETRY", "127.0.0.1", port]}
    with orthanc.server(tmp_path / "orthanc", DicomModalities=modalities) as archive:
        peer = Peer.parse(archive.peer)
        send(made, peer)
        assert committed(made, peer, listen=port) is True
        never = objects(exported(tmp_path / "other", subject="another", source="ef" * 32), ANNA)
        with pytest.raises(ArchiveError, match=r"\b12 of 12\b"):
            committed(never, peer, listen=port)


@ORTHANC
def test_the_worklist_fills_patient_and_order(tmp_path: Path) -> None:
    folder = tmp_path / "worklists"
    folder.mkdir()
    for number, (accession, name) in enumerate((("A123", "Zypernkatze^Quirina"), ("A124", "Muster^Anna"))):
        entry = Dataset()
        entry.SpecificCharacterSet = "ISO_IR 192"
        entry.AccessionNumber, entry.PatientID, entry.PatientName = accession, f"KIS-{number}", name
        entry.PatientBirthDate, entry.PatientSex = "19800229", "F"
        entry.StudyInstanceUID = f"1.2.3.{number}"
        entry.RequestedProcedureID, entry.RequestedProcedureDescription = f"P{number}", "Breast volumes"
        step = Dataset()
        step.ScheduledStationAETitle, step.Modality = "MAMMOMETRY", "XC"
        step.ScheduledProcedureStepStartDate, step.ScheduledProcedureStepStartTime = "20260301", "0900"
        entry.ScheduledProcedureStepSequence = Sequence([step])
        entry.save_as(folder / f"{number}.wl", implicit_vr=False, little_endian=True, enforce_file_format=False)
        _with_header(folder / f"{number}.wl", entry)
    settings = {"Worklists": {"Enable": True, "Database": str(folder)}}
    with orthanc.server(tmp_path / "orthanc", **settings) as archive:
        peer = Peer.parse(archive.peer)
        assert len(entries(peer, day=datetime.date(2026, 3, 1)).entries) == 2
        found = only_entry(entries(peer, accession="A123"), peer, "A123")
        assert found.patient.name == "Zypernkatze^Quirina"
        assert found.patient.born == datetime.date(1980, 2, 29)
        assert (found.order.study_uid, found.order.procedure) == ("1.2.3.0", "Breast volumes")
        with pytest.raises(ArchiveError, match=r"\b0 .*A999"):
            only_entry(entries(peer, accession="A999"), peer, "A999")


def _with_header(path: Path, entry: Dataset) -> None:
    from pydicom.dataset import FileMetaDataset
    from pydicom.uid import ExplicitVRLittleEndian

    entry.file_meta = FileMetaDataset()
    entry.file_meta.MediaStorageSOPClassUID = "1.2.276.0.7230010.3.1.0.1"
    entry.file_meta.MediaStorageSOPInstanceUID = "1.2.3"
    entry.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    entry.save_as(path, enforce_file_format=True)


# --- archives that fail ---


@contextmanager
def archive(handler: Any, made: list[Dataset], context: ssl.SSLContext | None = None) -> Iterator[Peer]:
    """An archive whose answers to C-STORE are chosen."""
    ae = AE(ae_title="PACS")
    for each in made:
        ae.add_supported_context(each.SOPClassUID, each.file_meta.TransferSyntaxUID)
    port = orthanc.free_port()
    server = ae.start_server(
        ("127.0.0.1", port), block=False, evt_handlers=[(evt.EVT_C_STORE, handler)], ssl_context=context
    )
    try:
        yield Peer(title="PACS", host="127.0.0.1", port=port)
    finally:
        server.shutdown()


@pytest.mark.parametrize(("status", "words"), [(0xA700, "room"), (0xC000, "refused")])
def test_a_full_or_refusing_archive_says_after_how_many(made: list[Dataset], status: int, words: str) -> None:
    came: list[str] = []

    def stored(event: Any) -> int:
        if len(came) == 3:
            return status
        came.append(event.request.AffectedSOPInstanceUID)
        return 0x0000

    with archive(stored, made) as peer, pytest.raises(ArchiveError, match=f"{words}.* 3 of 12 objects"):
        send(made, peer)


def test_an_archive_that_takes_no_models_gets_nothing(made: list[Dataset]) -> None:
    came: list[str] = []

    def stored(event: Any) -> int:
        came.append("")
        return 0x0000

    without = [each for each in made if each.Modality != "M3D"]
    with archive(stored, without) as peer, pytest.raises(ArchiveError, match="Encapsulated MTL"):
        send(made, peer)
    assert not came


def test_an_archive_without_promises_is_no_error(made: list[Dataset]) -> None:
    with archive(lambda event: 0x0000, made) as peer:
        assert send(made, peer).sent == len(made)
        assert committed(made, peer, answer_s=0.1) is None


def test_nobody_answers(made: list[Dataset]) -> None:
    with pytest.raises(ArchiveError, match="answers"):
        send(made, Peer(title="PACS", host="127.0.0.1", port=orthanc.free_port()))
    with pytest.raises(ArchiveError, match="answers"):
        stow(made, f"http://127.0.0.1:{orthanc.free_port()}/dicom-web")


# --- encryption ---


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed, which makes the certificate")
    folder = tmp_path_factory.mktemp("certificates")
    made, key = folder / "archive.pem", folder / "archive.key"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=127.0.0.1"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(made)]
    subprocess.run(command, check=True, capture_output=True)
    return made, key


def test_an_encrypted_archive_must_be_the_one_whose_certificate_is_trusted(
    made: list[Dataset], certificate: tuple[Path, Path]
) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*certificate)
    with archive(lambda event: 0x0000, made, context) as peer:
        assert send(made, peer, tls=PeerTls(authorities=certificate[0])).sent == len(made)
        with pytest.raises(ArchiveError, match="TLS"):
            send(made, peer, tls=PeerTls())


def test_a_certificate_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="certificate"):
        PeerTls(authorities=tmp_path / "none.pem").context()


# --- addresses ---


@pytest.mark.parametrize(
    "text", ["", "PACS", "PACS@host", "@host:104", "PACS@host:0", "PACS@host:99999", "A" * 17 + "@h:1"]
)
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="AE@host:port"):
        Peer.parse(text)


def test_an_address_is_read_as_it_is_written() -> None:
    assert str(Peer.parse("PACS@pacs.example.org:104")) == "PACS@pacs.example.org:104"
    assert Peer.parse("P@[::1]:104").host == "::1"


@pytest.mark.parametrize("url", ["pacs", "ftp://pacs/x", "https://", "https://pacs/x?y=1"])
def test_a_web_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(SettingsError, match="DICOMweb"):
        web_address(url)


def test_a_password_has_no_place_in_an_address() -> None:
    with pytest.raises(SettingsError, match="password") as caught:
        web_address("https://me:secret@pacs/dicom-web")
    assert "secret" not in str(caught.value)
