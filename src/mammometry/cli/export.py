"""The commands `export …`: results for other systems."""

from __future__ import annotations

import datetime
import os
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.common import Answer, Bars, Options, SessionOrScan, command
from mammometry.cli.stages import opened

if TYPE_CHECKING:
    from mammometry.hospital.exported import Exported, ExportedPatient, Order
    from mammometry.hospital.peers import PeerTls

app = typer.Typer(name="export", help="Write results for other systems: DICOM, FHIR, REDCap, tables.")


class Part(StrEnum):
    """Parts of a DICOM study that can be left out."""

    report = "report"
    models = "models"
    photographs = "photographs"


class Sex(StrEnum):
    """Sex of a patient, in DICOM's letters."""

    female = "F"
    male = "M"
    other = "O"


class FhirRelease(StrEnum):
    """Releases of FHIR."""

    r4 = "R4"
    r5 = "R5"


_Sessions = Annotated[list[Path], typer.Argument(metavar="SESSION...", help="Session folders.", show_default=False)]
_Deidentify = Annotated[
    bool, typer.Option("--deidentify", help="For others: no names, no dates, no photographs, no photographic colours.")
]
_PatientId = Annotated[str, typer.Option("--patient-id", help="Number of the patient's record.", show_default=False)]
_PatientName = Annotated[str, typer.Option("--patient-name", metavar="FAMILY^GIVEN", show_default=False)]
_Born = Annotated[datetime.datetime | None, typer.Option("--born", formats=["%Y-%m-%d"], show_default=False)]
_Sex = Annotated[Sex | None, typer.Option("--sex", show_default=False)]


@command(
    app,
    "mammometry export dicom SESSION --out objects",
    "mammometry export dicom SESSION --send PACS@10.0.0.5:104 --patient-id 4711 --patient-name 'Muster^Anna'",
    "mammometry export dicom SESSION --send PACS@pacs:2762 --tls --worklist RIS@ris:105 --accession A123",
    "mammometry export dicom SESSION --out for-others --deidentify",
)
def dicom(
    options: Options,
    session: SessionOrScan,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write the objects into a folder.", show_default=False)
    ] = None,
    send: Annotated[
        str | None, typer.Option(metavar="AE@HOST:PORT", help="Send them by C-STORE.", show_default=False)
    ] = None,
    stow: Annotated[
        str | None, typer.Option(metavar="URL", help="Send them by STOW-RS (DICOMweb).", show_default=False)
    ] = None,
    without: Annotated[
        list[Part] | None, typer.Option("--without", help="Leave a part out. May be repeated.", show_default=False)
    ] = None,
    deidentify: _Deidentify = False,
    patient_id: _PatientId = "",
    patient_name: _PatientName = "",
    born: _Born = None,
    sex: _Sex = None,
    accession: Annotated[str, typer.Option(help="Accession number of the order.", show_default=False)] = "",
    study_uid: Annotated[str, typer.Option(help="Study Instance UID of the order.", show_default=False)] = "",
    referring: Annotated[str, typer.Option(metavar="FAMILY^GIVEN", help="Who referred.", show_default=False)] = "",
    worklist: Annotated[
        str | None,
        typer.Option(
            metavar="AE@HOST:PORT", help="Take patient and order from the worklist's entry.", show_default=False
        ),
    ] = None,
    own_title: Annotated[str, typer.Option(help="Our AE title.")] = "MAMMOMETRY",
    commitment: Annotated[
        bool, typer.Option("--commitment", help="Wait for the archive's storage commitment, if it supports it.")
    ] = False,
    listen: Annotated[
        int | None, typer.Option(help="Port for the archive's storage commitment.", show_default=False)
    ] = None,
    tls: Annotated[bool, typer.Option("--tls", help="Encrypt the connection.")] = False,
    tls_ca: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Certificate authority of the archive, PEM.", show_default=False)
    ] = None,
    tls_certificate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Our certificate (PEM).", show_default=False)
    ] = None,
    tls_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Private key of our certificate (PEM).", show_default=False)
    ] = None,
) -> Answer:
    """Write or send a session as DICOM objects.

    One study: report (PDF), measurements (structured report), models (STL, OBJ), photographs. Objects that the archive
        already has are not sent again.
    """
    from mammometry.base.extras import require
    from mammometry.hospital.codes import require_text
    from mammometry.hospital.peers import AUTHORIZATION, Peer, PeerTls, require_encrypted, web_address
    from mammometry.io.outputs import require_apart, require_free, write_outputs

    if out is None and send is None and stow is None:
        raise typer.BadParameter("one of --out, --send and --stow says where the objects go")
    require("hospital", "pydicom", "pynetdicom", "highdicom")
    require_text(own_title, "AE", "--own-title")
    patient, order = _who(patient_id, patient_name, born, sex, accession, study_uid, referring)
    peer = None if send is None else Peer.parse(send)
    worklist_peer = None if worklist is None else Peer.parse(worklist)
    encrypted = PeerTls(authorities=tls_ca, certificate=tls_certificate, key=tls_key)
    chosen = encrypted if tls or encrypted != PeerTls() else None
    login = os.environ.get(AUTHORIZATION)
    if stow is not None:
        stow = web_address(stow)
        if login:
            require_encrypted(stow)
    if out is not None:
        require_apart(out, [session, options.file])
        from mammometry.hospital.dicom.objects import possible_names

        capture = session / "capture"
        taken = len(list(capture.iterdir())) if capture.is_dir() else 0
        require_free(out, possible_names(taken), command="export dicom")
    if worklist_peer is not None:
        patient, order = _from_worklist(worklist_peer, patient, order, own_title, chosen)

    from mammometry.hospital.dicom.objects import files, objects
    from mammometry.hospital.dicom.store import Sent
    from mammometry.hospital.dicom.store import send as send_to
    from mammometry.hospital.dicom.stow import stow as stow_to

    parts = [name for name, part in _PARTS.items() if part not in (without or ())]
    exported = _gathered(session, options, deidentify=deidentify, parts=parts)
    made = objects(exported, patient, order)
    lines: list[Any] = []
    table: dict[str, Any] = {"study": str(made[0].StudyInstanceUID), "objects": len(made)}
    if out is not None:
        written = files(made)
        write_outputs(out, written, command="export dicom")
        table |= {"folder": str(out), "files": sorted(written)}
        lines.append(f"{len(made)} objects in {out}")
    sent: dict[str, Sent] = {}
    with Bars(options.silent) as bars:
        if peer is not None:
            with bars.task("send", str(peer)) as progress:
                sent[str(peer)] = send_to(made, peer, own_title=own_title, tls=chosen, progress=progress)
        if stow is not None:
            with bars.task("send", stow) as progress:
                sent[stow] = stow_to(made, stow, tls=chosen, authorization=login, progress=progress)
    for where, what in sent.items():
        table[where] = {"sent": what.sent, "there_before": what.stored}
        before = f", {what.stored} were already there" if what.stored else ""
        lines.append(f"{where}: {what.sent} objects sent{before}")
    if commitment and peer is not None:
        from mammometry.hospital.dicom.store import committed

        kept = committed(made, peer, own_title=own_title, tls=chosen, listen=listen)
        table["committed"] = kept
        lines.append(
            "The archive committed to store all of them." if kept else "The archive sent no storage commitment."
        )
    return Answer(table, lines)


@command(app, "mammometry export fhir SESSION --out bundle", "mammometry export fhir SESSION --out bundle --release R5")
def fhir(
    options: Options,
    session: SessionOrScan,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for bundle.json.", show_default=False)],
    release: Annotated[FhirRelease, typer.Option(help="Release of FHIR.")] = FhirRelease.r4,
    deidentify: _Deidentify = False,
    patient_id: _PatientId = "",
    patient_name: _PatientName = "",
    born: _Born = None,
    sex: _Sex = None,
) -> Answer:
    """Write a session's measurements as a FHIR bundle.

    A report, and one observation per number with its interval as components. Sending the bundle twice changes nothing.
    """
    from mammometry.base.extras import require
    from mammometry.io.outputs import require_apart, require_free, write_outputs

    require("hospital", "fhir.resources")
    patient, _ = _who(patient_id, patient_name, born, sex)
    names = ("bundle.json",)
    require_apart(out, [session, options.file])
    require_free(out, names, command="export fhir")
    from mammometry.hospital.fhir import bundle

    exported = _gathered(session, options, deidentify=deidentify)
    write_outputs(out, {names[0]: bundle(exported, patient, release=release.value)}, command="export fhir")
    return Answer({"file": str(out / names[0])}, [f"FHIR {release.value}: {out / names[0]}"])


@command(app, "mammometry export redcap SESSION... --out for-redcap")
def redcap(
    options: Options,
    sessions: _Sessions,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for both files.", show_default=False)],
    deidentify: _Deidentify = False,
) -> Answer:
    """Write a study for REDCap: data dictionary and records.

    One row per visit. Importing it again changes nothing.
    """
    from mammometry.hospital import tables

    return _tables("export redcap", tables.redcap_tables, tables.REDCAP_FILES, sessions, out, deidentify, options)


@command(app, "mammometry export table SESSION... --out table")
def table(
    options: Options,
    sessions: _Sessions,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for table and codebook.", show_default=False)],
    deidentify: _Deidentify = False,
) -> Answer:
    """Write measurements as a table with a codebook.

    CSV, and Parquet if pyarrow is installed. One row per number.
    """
    from mammometry.hospital import tables

    return _tables("export table", tables.tables, tables.FILES, sessions, out, deidentify, options)


_PARTS = {"pdf": Part.report, "models": Part.models, "photographs": Part.photographs}


def _tables(
    command: str,
    make: Callable[[Sequence[Exported]], dict[str, bytes]],
    names: Sequence[str],
    sessions: list[Path],
    out: Path,
    deidentify: bool,
    options: Options,
) -> Answer:
    from mammometry.io.outputs import require_apart, require_free, write_outputs

    require_apart(out, [*sessions, options.file])
    require_free(out, names, command=command)
    gathered = [_gathered(session, options, deidentify=deidentify) for session in sessions]
    written = make(gathered)
    write_outputs(out, written, command=command)
    return Answer(
        {"folder": str(out), "files": sorted(written), "sessions": len(gathered)},
        [f"{len(gathered)} sessions in {out}: {', '.join(sorted(written))}"],
    )


def _gathered(session: Path, options: Options, *, deidentify: bool, parts: list[Any] | None = None) -> Exported:
    from mammometry.hospital.gather import gather

    with Bars(options.silent) as bars:
        return gather(opened(session, options, bars), deidentify=deidentify, parts=parts or ())


def _who(
    patient_id: str,
    patient_name: str,
    born: datetime.datetime | None,
    sex: Sex | None,
    accession: str = "",
    study_uid: str = "",
    referring: str = "",
) -> tuple[ExportedPatient, Order]:
    from mammometry.hospital.exported import ExportedPatient, Order

    day = None if born is None else born.date()
    patient = ExportedPatient(id=patient_id, name=patient_name, born=day, sex="" if sex is None else sex.value)
    return patient, Order(accession=accession, study_uid=study_uid, referring=referring)


def _from_worklist(
    peer: Any, patient: ExportedPatient, order: Order, own_title: str, tls: PeerTls | None
) -> tuple[ExportedPatient, Order]:
    """Patient and order from the one entry that matches the options."""
    from mammometry.hospital.dicom.worklist import entries, only_entry

    if not (order.accession or patient.id):
        raise typer.BadParameter("--worklist needs --accession or --patient-id to select an entry")
    answer = entries(peer, accession=order.accession, patient_id=patient.id, own_title=own_title, tls=tls)
    entry = only_entry(answer, peer, " and ".join(filter(None, (order.accession, patient.id))))
    return entry.patient, entry.order
