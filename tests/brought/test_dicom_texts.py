"""Texts that other systems must take: each field's limit is kept before anything is written."""

import io
import unicodedata
import warnings
from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path

import pytest
from pydicom import Dataset, config, dcmread
from tests.first_cases import first
from tests.unit.hospital.exports import ANNA, exported

from mammometry.base.errors import ArchiveError, SettingsError
from mammometry.cli import main
from mammometry.hospital.codes import text_fault
from mammometry.hospital.dicom.frame import encoded
from mammometry.hospital.dicom.objects import objects
from mammometry.hospital.dicom.worklist import only_entry, read_answers
from mammometry.hospital.exported import Exported, ExportedPatient, Order
from mammometry.hospital.fhir import bundle
from mammometry.hospital.peers import Peer
from mammometry.report.content import Clinical, Signed

LATIN_1 = b"M\xfcller".decode("utf-8", "surrogateescape")
"""As Python hands over an argument whose bytes are not UTF-8."""

REFUSED = [
    ("--patient-name", "Muster\\Anna", "the patient's name: ", "backslash"),
    ("--patient-name", "M" * 77, "the patient's name: ", "77 letters"),
    ("--patient-name", LATIN_1, "the patient's name: ", "position 2"),
    ("--patient-name", "A=B=C=D", "the patient's name: ", "4 groups"),
    ("--patient-name", "A^B^C^D^E^F", "the patient's name: ", "6 parts"),
    ("--patient-name", "Anna\x1b[31m", "the patient's name: ", "control"),
    ("--patient-id", "4711\\4712", "the patient's id: ", "backslash"),
    ("--patient-id", "4" * 72, "the patient's id: ", "72 letters"),
    ("--patient-id", "a\nb", "the patient's id: ", "control"),
    ("--accession", "A" * 17, "the accession number: ", "17 letters"),
    ("--study-uid", "1.2.03", "the study's UID: ", "identifier"),
    ("--study-uid", ".".join(["1"] * 33), "the study's UID: ", "65 letters"),
    (
        "--patient-name",
        "Moser\u202e^Anna",
        "the patient's name: ",
        "U+202E",
    ),
    ("--referring", "House\\Gregory", "the referring physician's name: ", "backslash"),
    ("--own-title", "MÜHLE", "--own-title: ", "ASCII"),
    ("--own-title", "A" * 17, "--own-title: ", "17 letters"),
]


IDS = [f"{option} {ascii(text)[:20]}" for option, text, *_ in REFUSED]


@pytest.mark.parametrize(("option", "text", "subject", "value"), REFUSED, ids=IDS)
@pytest.mark.requirement("R-IN-5")
def test_the_command_line_refuses_before_anything_is_made(
    tmp_path: Path, option: str, text: str, subject: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "session").mkdir()
    code = main.run(["export", "dicom", str(tmp_path / "session"), "--out", str(tmp_path / "out"), option, text])
    error = capsys.readouterr().err
    assert (code, error.count("\n")) == (3, 1)
    assert error.startswith(f"mammometry: {subject}")
    assert value in error.partition(", expected ")[0]
    assert ", expected " in error
    assert text not in error  # it may be a name
    assert not (tmp_path / "out").exists()


def test_a_fhir_bundle_refuses_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "session").mkdir()
    out = tmp_path / "out"
    code = main.run(["export", "fhir", str(tmp_path / "session"), "--out", str(out), "--patient-id", LATIN_1])
    assert code == 3
    assert "position 2" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("name", first(2, ["Yamada^Tarou=山田^太郎=やまだ^たろう", "Größe^Åse", "山田^太郎",
                                           "O'Neil-Smith^Zoë", "M" * 64, "١٢^ب"]))  # fmt: skip
def test_names_of_every_language_are_kept(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config.settings, "reading_validation_mode", config.RAISE)
    monkeypatch.setattr(config.settings, "writing_validation_mode", config.RAISE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = objects(exported(tmp_path), replace(ANNA, name=name, id="K" * 64))
        there = dcmread(io.BytesIO(encoded(made[0])))
    assert str(there.PatientName) == name
    assert there.PatientID == "K" * 64
    assert name.split("^")[0] in bundle(exported(tmp_path), replace(ANNA, name=name)).decode()


def test_every_allowed_text_is_valid_to_pydicom_and_every_refused_one_is_not() -> None:
    texts = ["", "a", "a\\b", "a" * 16, "a" * 17, "a" * 64, "a" * 65, "a^b^c^d^e", "a^b^c^d^e^f", "a=b=c", "a=b=c=d",
             "1.2.3", "1..2", "1.02", "0.1", "é", "a\tb", "a\x00"]  # fmt: skip
    fields = {"PN": "PatientName", "LO": "PatientID", "SH": "AccessionNumber", "UI": "StudyInstanceUID"}
    for representation, field in fields.items():
        for text in texts:
            allowed = text_fault(text, representation) is None  # type: ignore[arg-type]
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    made = Dataset()
                    setattr(made, field, text)
                    valid = made[field].VM <= 1
            except (UserWarning, ValueError):
                valid = False
            control = any(unicodedata.category(letter) == "Cc" for letter in text)  # pydicom lets pass
            six = text.count("^") == 5  # pydicom counts no parts
            assert allowed == (valid and not control and not (six and representation == "PN")), (representation, text)


def signed(by: str, text: str = "") -> Signed:
    return Signed(by=by, at=datetime(2026, 3, 2, tzinfo=UTC), text=text)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"organization": "A\\B"}, r"name: .*backslash"),
        ({"organization": "A" * 65}, r"name: .*65 letters"),
        ({"clinical": Clinical(confirmed=signed("A" * 64))}, r"boundaries: .*65 letters"),
        ({"clinical": Clinical(conclusions=(signed("Anna", "well\x07"),))}, r"conclusion: .*control"),
    ],
)
def test_what_the_clinic_says_is_checked_too(tmp_path: Path, changed: dict[str, object], sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence):
        exported(tmp_path, **changed)


def test_a_folder_whose_name_is_no_id_needs_one(tmp_path: Path) -> None:
    """It was cut off: two sessions became one patient."""
    nameless: Exported = exported(tmp_path, subject="x" * 65)
    for write in (objects, bundle):
        with pytest.raises(SettingsError, match=r"65 letters.*pseudonym.*--patient-id"):
            write(nameless)
        assert write(nameless, ANNA)
    assert str(objects(exported(tmp_path, subject="x" * 64))[0].PatientName) == "x" * 64


def test_years_have_four_digits(tmp_path: Path) -> None:
    made = objects(exported(tmp_path), replace(ANNA, born=date(985, 1, 2)))
    assert made[0].PatientBirthDate == "09850102"


# --- worklists ---


def answer(**texts: str) -> Dataset:
    entry = {"PatientID": "KIS-1", "PatientName": "Muster^Anna", "AccessionNumber": "A1", **texts}
    made = Dataset()
    made.SpecificCharacterSet = "ISO_IR 192"
    with config.disable_value_validation():
        for name, text in entry.items():
            setattr(made, name, text)
    return made


PEER = Peer(title="RIS", host="h", port=104)


@pytest.mark.parametrize(
    ("texts", "sentence"),
    [
        ({"PatientID": "1\\2"}, r"entry A1: .*\bid .*backslash .*\b2"),
        ({"PatientName": "A\\B"}, r"entry A1: .*name .*backslash"),
        ({"PatientID": "1" * 65}, r"\bid .*65 letters"),
        ({"PatientName": "M\ufffdller"}, r"name .*byte .*\b2"),
        ({"AccessionNumber": "A" * 20}, r"number: .*\b20"),
    ],
)
def test_an_entry_that_cannot_be_used_is_set_aside_and_named(texts: dict[str, str], sentence: str) -> None:
    worklist = read_answers([answer(**texts), answer(AccessionNumber="A2")], PEER)
    assert [entry.order.accession for entry in worklist.entries] == ["A2"]
    with pytest.raises(ArchiveError, match=sentence):
        only_entry(worklist, PEER, "KIS-1")


def test_an_entry_in_latin_1_is_read_as_it_says() -> None:
    made = answer()
    made.SpecificCharacterSet = "ISO_IR 100"
    made.PatientName = "Müller^Zoë"
    buffer = io.BytesIO()
    made.save_as(buffer, implicit_vr=True, little_endian=True, enforce_file_format=False)
    read = dcmread(io.BytesIO(buffer.getvalue()), force=True)
    (entry,) = read_answers([read], PEER).entries
    assert entry.patient.name == "Müller^Zoë"


def test_long_words_of_a_procedure_are_cut() -> None:
    (entry,) = read_answers([answer(RequestedProcedureDescription="w" * 90)], PEER).entries
    assert entry.order.procedure == "w" * 64


def test_patient_and_order_check_themselves() -> None:
    with pytest.raises(SettingsError, match=r"id: .*17 letters"):
        Order(procedure_id="P" * 17)
    with pytest.raises(SettingsError, match=r"id: .*backslash .*\b3"):
        ExportedPatient(id="ab\\c")
