"""One measured and confirmed visit: page, editor, PDF, study's table, DICOM and FHIR give the same numbers."""

import csv
import io
import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pydicom
import pypdf
import pytest
from django.test import Client
from django.urls import reverse
from tests.unit.clinic.test_clinic_scans import send
from tests.unit.io.scan_files import scanned

from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.jobs import queue, work
from mammometry.clinic.models import Conclusion, Consent, Measurement, Patient, Visit
from mammometry.clinic.roles import Role
from mammometry.hospital.exported import Quantity

pytestmark = pytest.mark.slow
Table = dict[str, tuple[float, float | None, float | None]]
"""Code and side → value, and the ends of its 95 % interval where there is one."""


def measured(client: Client, patient: Patient, folder: Path) -> Visit:
    """A scan of a trunk, measured as the clinic's worker does."""
    mesh = scanned(folder, step_mm=2.0)
    send(client, patient, {path.name: path.read_bytes() for path in mesh.parent.iterdir()})
    (job,) = queue.claim("me", 1)
    visit = Visit.objects.get()
    assert queue.done(job.pk, "me", work.measure_scan(lambda stage, fraction: None, str(visit.folder), ""))
    visit.refresh_from_db()
    how = visit.measurements.get().how
    assert (how["settings"], set(how["boundaries"].values())) == ({}, {"automatic"})
    assert set(how["walls"]) == {"left", "right"}
    return visit


def confirm(client: Client, visit: Visit) -> None:
    """As the page does that shows what was measured."""
    measurement = visit.measurements.get()
    base = {"boundaries": dict.fromkeys(measurement.curves), "landmarks": {}}
    sent = json.dumps({"curves": measurement.curves, "base": base})
    answer = client.post(reverse("draw-finish", args=[visit.pk]), sent, content_type="application/json")
    assert answer.json() == {"next": reverse("visit", args=[visit.pk])}


def of_database(measurement: Measurement) -> Table:
    return {
        row["code"] + "_" + row["side"]: (row["value"], *(row["interval_95"] or (None, None)))
        for row in measurement.quantities
    }


def as_exported(measurement: Measurement) -> Table:
    """The same with the digits that the uncertainties justify, as exports give them."""
    table: Table = {}
    for row in measurement.quantities:
        interval = row["interval_95"]
        rounded = Quantity(**{**row, "interval_95": None if interval is None else tuple(interval)}).rounded()
        table[f"{rounded.code}_{rounded.side}"] = (rounded.value, *(rounded.interval_95 or (None, None)))
    return table


def of_fhir(content: bytes) -> Table:
    sides = {"80248007": "left", "73056007": "right"}
    table: Table = {}
    for resource in (entry["resource"] for entry in json.loads(content)["entry"]):
        if resource["resourceType"] == "Observation" and "valueQuantity" in resource:
            side = sides.get(resource["bodySite"]["coding"][0]["code"], "") if "bodySite" in resource else ""
            limits = {
                part["code"]["coding"][0]["code"]: part["valueQuantity"]["value"]
                for part in resource.get("component", ())
                if "valueQuantity" in part
            }
            name = resource["code"]["coding"][0]["code"] + "_" + side
            table[name] = (resource["valueQuantity"]["value"], limits.get("lower-95"), limits.get("upper-95"))
    return table


def of_dicom(report: pydicom.Dataset) -> Table:
    sides = {"Left breast": "left", "Right breast": "right", "Both sides": ""}
    values: dict[str, float] = {}
    named = [(item.ConceptNameCodeSequence[0].get("CodeValue"), item) for item in report.ContentSequence]
    (groups,) = [item for code, item in named if code == "126010"]
    for group in groups.ContentSequence:
        items = group.ContentSequence
        title = next(i.TextValue for i in items if i.ConceptNameCodeSequence[0].CodeMeaning == "Tracking Identifier")
        for item in items:
            if item.ValueType == "NUM":
                concept = item.ConceptNameCodeSequence[0]
                code = concept.get("CodeValue") or concept.LongCodeValue  # of more than 16 characters
                name, _, limit = code.partition(".")
                values[f"{name}_{sides[title]}.{limit}"] = float(item.MeasuredValueSequence[0].NumericValue)
    names = {name.partition(".")[0] for name in values}
    return {
        name: (values[f"{name}."], values.get(f"{name}.lower-95"), values.get(f"{name}.upper-95")) for name in names
    }


def same(one: Table, other: Table) -> None:
    assert one.keys() == other.keys()
    for name, figures in one.items():
        assert figures == pytest.approx(other[name], abs=1e-4), name


def unzipped(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.requirement("R-WHO-7")
def test_the_figures_are_the_same_numbers_everywhere(
    client_of: Callable[..., Client], clinic: ClinicConfig, tmp_path: Path
) -> None:
    """No name that stands on paper or in exports is written into the session."""
    patient = Patient.objects.create(
        family_name="Zypernkatze", given_name="Quirina", record_number="KIS-4711", born="1980-02-29"
    )
    Consent.objects.create(patient=patient, purpose="research", given_on="2026-01-01")
    client, researcher = client_of(Role.CLINICIAN, name="Dr. Rosa Luchs"), client_of(Role.RESEARCHER)
    visit = measured(client, patient, tmp_path / "in")
    measurement = visit.measurements.get()
    assert set(measurement.curves) == {"left", "right"}
    truth = of_database(measurement)
    assert len(truth) > 10
    confirm(client, visit)
    Conclusion.objects.create(
        visit=visit, measurement=measurement, text="Larger on the right.", by=measurement.confirmations.get().by
    )

    # To programs: every number.
    exported = as_exported(measurement)
    for release in ("r4", "r5"):
        fhir = client.get(reverse("visit-fhir", args=[visit.pk, release])).content
        same(of_fhir(fhir), exported)
        (report,) = [
            e["resource"] for e in json.loads(fhir)["entry"] if e["resource"]["resourceType"] == "DiagnosticReport"
        ]
        assert (report["status"], report["performer"]) == ("final", [{"display": "Dr. Rosa Luchs"}])
        assert report["conclusion"].startswith("Larger on the right.")
    files = unzipped(client.get(reverse("visit-dicom", args=[visit.pk])).content)
    structured = pydicom.dcmread(io.BytesIO(files["02-SR-001.dcm"]))
    same(of_dicom(structured), exported)
    assert (structured.VerificationFlag, structured.PreliminaryFlag) == ("VERIFIED", "FINAL")
    assert str(structured.VerifyingObserverSequence[0].VerifyingObserverName).rstrip("^") == "Dr. Rosa Luchs"
    table = unzipped(researcher.get(reverse("study-table")).content)["measurements.csv"].decode()
    rows = list(csv.DictReader(io.StringIO(table)))
    number = {"": None}
    told = {
        row["code"] + "_" + row["side"]: tuple(
            number.get(row[name], float(row[name] or 0)) for name in ("value", "low_95", "high_95")
        )
        for row in rows
    }
    same(told, exported)  # type: ignore[arg-type]
    assert {row["confirmed"] for row in rows} == {"yes"}
    assert "Luchs" not in table

    # To people: what leads, as it is shown.
    encapsulated = pydicom.dcmread(io.BytesIO(files["01-DOC-001.dcm"])).EncapsulatedDocument
    paper = client.get(reverse("report-pdf", args=[visit.pk]))
    page = words(client.get(reverse("visit", args=[visit.pk])).content.decode())
    shown = client.get(reverse("draw-drawing", args=[visit.pk]))
    cohort = list(csv.DictReader(io.StringIO(researcher.get(reverse("study-csv")).content.decode())))
    for side in ("left", "right"):
        value, low, high = truth[f"volume_flat_chest_{side}"]
        assert low is not None
        assert high is not None
        (row,) = [row for row in cohort if row["side"] == side]
        assert (row["volume_cc"], row["low_cc"], row["high_cc"]) == tuple(f"{x:.1f}" for x in (value, low, high))
        assert (row["confirmed"], row["state"]) == ("True", "confirmed")
        assert f"{value:.0f} cc" in page
        assert f"{low:.0f} to {high:.0f} cc" in page
        for document in (paper.content, encapsulated):
            text = words(" ".join(one.extract_text() for one in pypdf.PdfReader(io.BytesIO(document)).pages))
            assert f"{value:.0f}" in re.findall(r"\d+", text)
            assert f"{low:.0f} to {high:.0f}" in text
            assert "Luchs" in text
            assert "Larger on the right." in text
        live = shown.json()["boundaries"][side]["measured"]
        assert (live["volumeCc"], *live["intervalCc"]) == pytest.approx((value, low, high))
    held = b"".join(path.read_bytes() for path in visit.folder.rglob("*") if path.is_file())
    assert not [name for name in (b"Luchs", b"Zypernkatze", b"Quirina", b"KIS-4711", b"Larger on") if name in held]


def words(text: str) -> str:
    """Without tags and line breaks."""
    return " ".join(re.sub(r"<[^>]*>", " ", text).split())
