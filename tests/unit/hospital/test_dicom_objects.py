"""Objects of a study: the same bytes each time, what they say, and what they do not tell."""

import io
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pydicom import Dataset, config, dcmread
from pydicom.encaps import generate_frames
from tests.unit.hospital.exports import ANNA, NAMES, ORDER, deidentified, exported, one_sided, quantities, signed

from mammometry.base.notices import Notice
from mammometry.base.notices.words import words_of
from mammometry.hospital.dicom.frame import encoded
from mammometry.hospital.dicom.objects import baseline, files, objects
from mammometry.hospital.fhir import bundle

DCMTK = pytest.mark.skipif(shutil.which("dsrdump") is None, reason="dcmtk is not installed (apt-get install dcmtk)")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> list[Dataset]:
    return objects(exported(tmp_path_factory.mktemp("session")), ANNA, ORDER)


def of_kind(made: list[Dataset], modality: str) -> list[Dataset]:
    return [each for each in made if each.Modality == modality]


def test_the_same_session_gives_the_same_bytes(made: list[Dataset], tmp_path: Path) -> None:
    assert files(objects(exported(tmp_path), ANNA, ORDER)) == files(made)


def test_one_study_and_one_series_a_kind(made: list[Dataset]) -> None:
    assert {each.StudyInstanceUID for each in made} == {ORDER.study_uid}
    series: dict[str, set[str]] = {}
    for each in made:
        series.setdefault(each.SeriesInstanceUID, set()).add(f"{each.SeriesNumber} {each.SeriesDescription}")
    assert all(len(names) == 1 for names in series.values())
    assert len(series) == 6
    assert len({each.SOPInstanceUID for each in made}) == len(made) == 12


def test_another_number_is_another_object_of_the_same_study(made: list[Dataset], tmp_path: Path) -> None:
    before = exported(tmp_path)
    first, *others = before.quantities
    after = objects(replace(before, quantities=(replace(first, value=first.value + 1e-3), *others)), ANNA, ORDER)
    changed = {each.SOPInstanceUID for each in after} ^ {each.SOPInstanceUID for each in made}
    assert changed == {*(of_kind(made, "SR")[0].SOPInstanceUID,), *(of_kind(after, "SR")[0].SOPInstanceUID,)}


def test_every_object_is_valid_to_pydicom(made: list[Dataset], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config.settings, "reading_validation_mode", config.RAISE)
    monkeypatch.setattr(config.settings, "writing_validation_mode", config.RAISE)
    for each in made:
        there = dcmread(io.BytesIO(encoded(each)))
        for element in there.iterall():
            assert element.value is not NotImplemented  # reading it checks it
        assert there.file_meta.MediaStorageSOPInstanceUID == there.SOPInstanceUID
        assert there.SOPInstanceUID.is_valid
        assert there.PatientID == "KIS-4711"
        assert there.PatientBirthDate == "19800229"
        assert there.AccessionNumber == "A123"


@pytest.mark.parametrize(("kind", "stated"), [("torso", {"ImageLaterality": "B"}), ("model", {"Laterality": ""})])
def test_pictures_of_a_paired_structure_state_their_side(tmp_path: Path, kind: str, stated: dict[str, str]) -> None:
    """PS3.3, C.7.3.1: Laterality, type 2C, unless Image Laterality is there. dciodvfy missed both."""
    pictures = of_kind(objects(replace(exported(tmp_path), kind=kind), ANNA, ORDER), "XC")
    assert len(pictures) == 3
    for picture in pictures:
        found = {name: picture[name].value or "" for name in ("ImageLaterality", "Laterality") if name in picture}
        assert found == stated


def test_documents_are_held_as_they_were(made: list[Dataset], tmp_path: Path) -> None:
    source = exported(tmp_path)
    held = {
        (each.MIMETypeOfEncapsulatedDocument, each.get("ImageLaterality", "")): bytes(each.EncapsulatedDocument)[
            : each.EncapsulatedDocumentLength
        ]
        for each in made
        if "EncapsulatedDocument" in each
    }
    assert source.covered is not None
    letters = {"left": "L", "right": "R", "": ""}
    assert held == {
        ("application/pdf", ""): source.report_pdf,
        ("model/mtl", ""): source.covered.mtl,
        **{("model/stl", letters[each.side]): each.stl for each in source.models},
        **{("model/obj", letters[each.side]): each.obj for each in source.covered.models},
    }


def test_the_material_is_found_by_the_name_that_the_model_uses(made: list[Dataset]) -> None:
    by_uid = {each.SOPInstanceUID: each for each in made}
    objs = [each for each in made if each.get("MIMETypeOfEncapsulatedDocument") == "model/obj"]
    assert len(objs) == 3
    references = [each.ReferencedInstanceSequence[0] for each in objs]
    assert {each.RelativeURIReferenceWithinEncapsulatedDocument for each in references} == {"model.mtl"}
    (mtl_uid,) = {each.ReferencedSOPInstanceUID for each in references}
    mtl = by_uid[mtl_uid]
    texture = by_uid[mtl.ReferencedInstanceSequence[0].ReferencedSOPInstanceUID]
    assert texture.SOPClassUID.name == "VL Photographic Image Storage"


def test_a_photograph_keeps_its_pixels_and_loses_its_tags(made: list[Dataset], tmp_path: Path) -> None:
    source = exported(tmp_path)
    front, side = [each for each in of_kind(made, "XC") if each.SeriesDescription == "Photographs"]
    (frame,) = generate_frames(front.PixelData, number_of_frames=1)
    with Image.open(io.BytesIO(frame)) as opened:
        assert not opened.getexif()
        assert np.array_equal(np.asarray(opened), source.photographs["front"].pixels)
    assert frame.count(b"Zypernkatze") == frame.count(b"Quirina") == 0
    pixels = np.frombuffer(side.PixelData, np.uint8)[: 15 * 21 * 3].reshape(15, 21, 3)
    assert np.array_equal(pixels, source.photographs["side"].pixels)


def test_a_progressive_jpeg_is_not_taken_over(tmp_path: Path) -> None:
    Image.new("RGB", (8, 8)).save(tmp_path / "a.jpg", progressive=True)
    assert baseline(tmp_path / "a.jpg") is None
    Image.new("RGB", (8, 8)).save(tmp_path / "b.jpg")
    assert baseline(tmp_path / "b.jpg") is not None


def numbers(report: Dataset) -> dict[tuple[str, str], tuple[float, str]]:
    """(side, name) → value and unit of all measurements, read without highdicom."""
    found = {}
    (groups,) = [item for item in report.ContentSequence if item.ConceptNameCodeSequence[0].CodeValue == "126010"]
    for group in groups.ContentSequence:
        items = group.ContentSequence
        side = next(i.TextValue for i in items if i.ConceptNameCodeSequence[0].CodeMeaning == "Tracking Identifier")
        for item in items:
            if item.ValueType == "NUM":
                value = item.MeasuredValueSequence[0]
                unit = value.MeasurementUnitsCodeSequence[0].CodeValue
                name = item.ConceptNameCodeSequence[0].CodeMeaning
                found[side, name] = float(value.NumericValue), unit
    return found


def test_the_structured_report_says_volumes_intervals_and_lengths(made: list[Dataset]) -> None:
    found = numbers(of_kind(made, "SR")[0])
    assert found["Left breast", "Volume"] == (354.25, "cm3")
    assert found["Left breast", "Volume: lower limit of the 95 % interval"] == (313.75, "cm3")
    assert found["Left breast", "Volume: upper limit of the 95 % interval"] == (396.5, "cm3")
    assert found["Right breast", "Nipple below the fold"] == (-38.5, "mm")
    assert found["Both sides", "nipple to nipple, straight"] == (201.25, "mm")


@pytest.mark.slow
@DCMTK
def test_dcmtk_reads_the_report(made: list[Dataset], tmp_path: Path) -> None:
    for name, content in files(made).items():
        (tmp_path / name).write_bytes(content)
        subprocess.run(["dcmdump", "-q", tmp_path / name], check=True, capture_output=True)
    shown = subprocess.run(
        ["dsrdump", "+Pl", tmp_path / "02-SR-001.dcm"], check=True, capture_output=True, text=True
    ).stdout
    assert '"354.25" (cm3,UCUM,"cubic centimeter")' in shown
    assert '(cylinder-membrane,99MAMMOMETRY,"cylinder-membrane")' in shown
    assert shown.count('(7771000,SCT,"Left")') == 1
    assert shown.count('(24028007,SCT,"Right")') == 1
    assert '"+, range of upper measurement uncertainty")="42.25" (cm3' in shown
    assert '"+, range of upper measurement uncertainty")="3.75" (mm' in shown


def test_warnings_go_with_the_numbers(tmp_path: Path) -> None:
    headless = Notice(code="head-not-shown", about=("left", "right"))
    leaking = Notice(code="solid-not-watertight", about=("right",))
    warned = exported(tmp_path, notices=(headless, leaking))
    (report,) = of_kind(objects(warned, ANNA), "SR")
    concepts = [(item.ConceptNameCodeSequence[0], item) for item in report.ContentSequence]
    texts = {code_of(name): item.TextValue for name, item in concepts if name.CodeMeaning.startswith("Warning")}
    assert texts == {notice.code: words_of(notice) for notice in warned.notices}
    notes: dict[str, set[str]] = {}
    for entry in json.loads(bundle(warned, ANNA))["entry"]:
        if entry["resource"].get("code", {}).get("coding", [{}])[0].get("code") == "volume":
            side = entry["resource"]["bodySite"]["text" if "text" in entry["resource"]["bodySite"] else "coding"]
            notes[str(side)] = {note["text"] for note in entry["resource"]["note"]} & set(texts.values())
    assert sorted(map(len, notes.values())) == [1, 2]
    assert exported(tmp_path).digest != warned.digest


def code_of(concept: Dataset) -> str:
    return str(concept.get("CodeValue") or concept.LongCodeValue)


def test_a_side_without_a_breast_says_so(tmp_path: Path) -> None:
    (report,) = of_kind(objects(one_sided(tmp_path), ANNA), "SR")
    words = str(report)
    assert "No breast on this side" in words
    assert ("Right breast", "Volume") not in numbers(report)


@pytest.mark.slow
def test_a_deidentified_study_tells_no_name_and_no_day(tmp_path: Path) -> None:
    made = objects(deidentified(tmp_path), ANNA, ORDER)
    assert {each.Modality for each in made} == {"DOC", "SR", "M3D"}
    for each in made:
        content = encoded(each)
        assert not [name for name in NAMES if name.encode() in content]
        assert each.PatientIdentityRemoved == "YES"
        assert each.DeidentificationMethodCodeSequence[0].CodeValue == "113100"
        assert not [
            element
            for element in each.iterall()
            if element.VR in ("DA", "DT") and element.value not in ("", None, "19000101")
        ]
    assert files(made) == files(objects(deidentified(tmp_path)))


@pytest.mark.slow
def test_without_a_patient_the_subject_is_the_patient(tmp_path: Path) -> None:
    assert {each.PatientID for each in objects(exported(tmp_path))} == {"P-EXAMPLE"}


@pytest.mark.slow
def test_two_patients_with_the_same_photographs_are_two_studies(tmp_path: Path) -> None:
    one, other = (objects(exported(tmp_path), replace(ANNA, id=number))[0] for number in ("1", "2"))
    assert one.StudyInstanceUID != other.StudyInstanceUID


def test_a_confirmed_report_is_verified_and_holds_the_conclusion(tmp_path: Path) -> None:
    (report,) = of_kind(objects(signed(tmp_path), ANNA, ORDER), "SR")
    assert (report.VerificationFlag, report.PreliminaryFlag) == ("VERIFIED", "FINAL")
    (observer,) = report.VerifyingObserverSequence
    assert str(observer.VerifyingObserverName).rstrip("^") == "Dr. Rosa Luchs"
    assert (observer.VerifyingOrganization, observer.VerificationDateTime) == ("Test clinic", "20260302110005+0000")
    (whole,) = [item for item in report.ContentSequence if item.ConceptNameCodeSequence[0].CodeValue == "121076"]
    (conclusion,) = whole.ContentSequence
    assert (conclusion.TextValue, conclusion.ObservationDateTime) == ("Larger on the right.", "20260303083000+0000")
    assert str(conclusion.ContentSequence[0].PersonName).rstrip("^") == "Prof. Egon Dachs"
    assert numbers(report)["Left breast", "Volume"] == (354.25, "cm3")


@pytest.mark.slow
def test_what_is_verified_is_not_said_to_be_confirmed_yet(tmp_path: Path) -> None:
    automatic = tuple(
        replace(quantity, boundary="automatic: the fold", boundary_remarks=("to-be-confirmed",))
        for quantity in quantities()
    )
    (verified,) = of_kind(objects(replace(signed(tmp_path), quantities=automatic), ANNA, ORDER), "SR")
    (before,) = of_kind(objects(exported(tmp_path, quantities=automatic), ANNA, ORDER), "SR")
    assert (verified.VerificationFlag, before.VerificationFlag) == ("VERIFIED", "UNVERIFIED")
    methods = [re.findall("automatic: the fold; [a-z ]*", report.to_json()) for report in (before, verified)]
    assert all(methods)
    assert not set(methods[0]) & set(methods[1])


def test_what_nobody_confirmed_or_concluded_is_not_said_to_be(made: list[Dataset], tmp_path: Path) -> None:
    (before,) = of_kind(made, "SR")
    assert (before.VerificationFlag, before.PreliminaryFlag) == ("UNVERIFIED", "PRELIMINARY")
    (without,) = of_kind(objects(signed(tmp_path, concluded=False), ANNA, ORDER), "SR")
    assert (without.VerificationFlag, without.PreliminaryFlag) == ("VERIFIED", "PRELIMINARY")
    assert "121076" not in str(without)


@pytest.mark.slow
@DCMTK
def test_dcmtk_reads_a_verified_report(tmp_path: Path) -> None:
    (report,) = of_kind(objects(signed(tmp_path / "in"), ANNA, ORDER), "SR")
    (tmp_path / "sr.dcm").write_bytes(encoded(report))
    shown = subprocess.run(["dsrdump", tmp_path / "sr.dcm"], check=True, capture_output=True, text=True).stdout
    assert "Dr. Rosa Luchs" in shown
    assert "Larger on the right." in shown
