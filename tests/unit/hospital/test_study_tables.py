"""FHIR, REDCap and tables: what they say, and that saying it again changes nothing."""

import csv
import io
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.unit.hospital.exports import ANNA, NAMES, deidentified, exported, one_sided, quantities, signed

from mammometry.base.errors import StorageError, TableError
from mammometry.base.extras import require
from mammometry.hospital import tables
from mammometry.hospital.exported import Quantity
from mammometry.hospital.fhir import Release, bundle
from mammometry.hospital.gather import confirmed
from mammometry.measure.volume.attribution import Attribution, CurveConfirmation, curve_digest


def rows(text: str | bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text if isinstance(text, str) else text.decode())))


# --- FHIR ---


def resources(made: bytes, kind: str) -> list[dict[str, Any]]:
    return [e["resource"] for e in json.loads(made)["entry"] if e["resource"]["resourceType"] == kind]


@pytest.mark.parametrize("release", ["R4", "R5"])
def test_a_bundle_is_the_same_each_time_and_valid(tmp_path: Path, release: Release) -> None:
    made = bundle(exported(tmp_path), ANNA, release=release)
    assert made == bundle(exported(tmp_path), ANNA, release=release)
    volume = resources(made, "Observation")[0]
    assert volume["valueQuantity"] == {
        "value": 354.25,
        "unit": "cm3",
        "system": "http://unitsofmeasure.org",
        "code": "cm3",
    }
    limits = {each["code"]["coding"][0]["code"]: each["valueQuantity"]["value"] for each in volume["component"][:2]}
    assert limits == {"lower-95": 313.75, "upper-95": 396.5}
    assert volume["method"]["coding"][0]["code"] == "closed-mesh"
    (report,) = resources(made, "DiagnosticReport")
    assert len(report["result"]) == len(quantities())
    references = {each["reference"] for each in report["result"]}
    assert references == {f"Observation/{each['id']}" for each in resources(made, "Observation")}


def test_every_entry_is_put_under_its_own_id(tmp_path: Path) -> None:
    entries = json.loads(bundle(exported(tmp_path), ANNA))["entry"]
    assert {each["request"]["method"] for each in entries} == {"PUT"}
    assert len({each["request"]["url"] for each in entries}) == len(entries)


def test_a_missing_breast_has_a_reason_in_place_of_a_value(tmp_path: Path) -> None:
    made = resources(bundle(one_sided(tmp_path)), "Observation")
    (none,) = [each for each in made if "dataAbsentReason" in each]
    assert none["dataAbsentReason"]["coding"][0]["code"] == "none"
    assert "valueQuantity" not in none


def test_a_deidentified_bundle_names_nobody(tmp_path: Path) -> None:
    text = bundle(deidentified(tmp_path), ANNA).decode()
    assert not [name for name in NAMES if name in text]


def test_codes_that_are_not_ours_are_in_pydicoms_dictionary(tmp_path: Path) -> None:
    from pydicom.sr._concepts_dict import concepts

    known = {scheme: {code for all_ in concepts[scheme].values() for code in all_} for scheme in ("SCT", "LN")}
    systems = {"http://snomed.info/sct": "SCT", "http://loinc.org": "LN"}

    def codings(there: Any) -> list[dict[str, str]]:
        if isinstance(there, dict):
            here = there.get("coding", [])
            return [*here, *(each for value in there.values() for each in codings(value))]
        return [each for value in there for each in codings(value)] if isinstance(there, list) else []

    used = [each for each in codings(json.loads(bundle(signed(tmp_path), ANNA))) if each["system"] in systems]
    assert {each["system"] for each in used} == set(systems)
    assert all(each["code"] in known[systems[each["system"]]] for each in used)


# --- REDCap ---


def test_records_do_not_depend_on_the_order_of_sessions(tmp_path: Path) -> None:
    one, other = exported(tmp_path / "one"), one_sided(tmp_path / "two")
    object.__setattr__(other, "source", "cd" * 32)
    assert tables.redcap_tables([one, other]) == tables.redcap_tables([other, one])
    found = rows(tables.records([one, other]))
    assert [each["record_id"] for each in found] == ["abababababab", "cdcdcdcdcdcd"]
    assert found[0]["volume_left"] == "354.25"
    assert found[0]["nipple_below_fold_left"] == "-38.5"
    assert (found[1]["volume_right"], found[1]["why_right"]) == ("", "none")


def test_every_measured_number_has_its_field_in_the_dictionary(tmp_path: Path) -> None:
    fields = [each["Variable / Field Name"] for each in rows(tables.dictionary())]
    assert len(set(fields)) == len(fields)
    assert fields == list(rows(tables.records([exported(tmp_path)]))[0])
    assert {each.name for each in quantities()} <= set(fields)
    assert all(name.replace("_", "").isalnum() and name.islower() and len(name) <= 100 for name in fields)


def test_the_same_visit_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"^P-EXAMPLE: .*photographs"):
        tables.records([exported(tmp_path), exported(tmp_path)])


# --- tables ---


def test_a_table_and_its_codebook(tmp_path: Path) -> None:
    made = tables.tables([one_sided(tmp_path)])
    found = rows(made[tables.TABLE])
    volume = next(each for each in found if each["code"] == "volume" and each["side"] == "left")
    assert (volume["value"], volume["low_95"], volume["high_95"], volume["unit"]) == (
        "354.25",
        "313.75",
        "396.5",
        "cm3",
    )
    assert [each["why"] for each in found if each["side"] == "right"] == ["none"]
    explained = {(each["of"], each["name"]) for each in rows(made[tables.CODEBOOK])}
    assert {("column", name) for name in found[0]} <= explained
    assert {("code", each["code"]) for each in found if each["value"]} <= explained
    assert {("method", each["method"]) for each in found if each["method"]} <= explained


def test_parquet_says_the_same_as_csv(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    made = tables.tables([exported(tmp_path)])
    there = parquet.read_table(io.BytesIO(made[tables.PARQUET])).to_pylist()
    told = rows(made[tables.TABLE])
    assert [{name: "" if cell is None else str(cell) for name, cell in row.items()} for row in there] == told


# --- without the libraries ---


def test_a_missing_library_is_one_sentence() -> None:
    require("hospital", "csv")
    with pytest.raises(StorageError, match=r"no_such_library\b.*'mammometry\[hospital\]'"):
        require("hospital", "csv", "no_such_library")
    with pytest.raises(StorageError, match=r"no_such_library\.inner"):
        require("hospital", "no_such_library.inner")


# --- what a clinic knows beside the numbers ---


@pytest.mark.parametrize("release", ["R4", "R5"])
def test_a_confirmed_and_concluded_report_is_final_and_says_by_whom(tmp_path: Path, release: Release) -> None:
    made = bundle(signed(tmp_path), ANNA, release=release)
    (report,) = resources(made, "DiagnosticReport")
    assert report["status"] == "final"
    assert report["conclusion"].startswith("Larger on the right.\nFor research use only.")
    assert report["performer"] == [{"display": "Dr. Rosa Luchs"}]
    assert report["resultsInterpreter"] == [{"display": "Prof. Egon Dachs"}]
    assert {each["status"] for each in resources(made, "Observation")} == {"final"}
    told = {
        each["agent"][0]["type"]["coding"][0]["code"]: (each["agent"][0]["who"]["display"], each["recorded"])
        for each in resources(made, "Provenance")
    }
    assert told == {
        "verifier": ("Dr. Rosa Luchs", "2026-03-02T11:00:05+00:00"),
        "author": ("Prof. Egon Dachs", "2026-03-03T08:30:00+00:00"),
    }
    assert {each["target"][0]["reference"] for each in resources(made, "Provenance")} == {
        f"DiagnosticReport/{report['id']}"
    }


def test_without_a_conclusion_it_stays_preliminary(tmp_path: Path) -> None:
    (report,) = resources(bundle(signed(tmp_path, concluded=False), ANNA), "DiagnosticReport")
    assert report["status"] == "preliminary"
    (before,) = resources(bundle(exported(tmp_path), ANNA), "DiagnosticReport")
    assert before["id"] == report["id"]  # sent again, it replaces what was sent
    assert not resources(bundle(exported(tmp_path), ANNA), "Provenance")


@pytest.mark.parametrize(("release", "moment"), [("R4", "performedDateTime"), ("R5", "occurrenceDateTime")])
def test_operations_are_coded_only_where_a_code_is_known(tmp_path: Path, release: Release, moment: str) -> None:
    implant, conserving = resources(bundle(signed(tmp_path), ANNA, release=release), "Procedure")
    assert implant["code"]["coding"][0]["code"] == "302343007"
    assert [site["coding"][0]["code"] for site in implant["bodySite"]] == ["80248007", "73056007"]
    assert conserving["code"] == {"text": "Breast-conserving surgery"}
    assert implant[moment] == "2025-05-06"


def test_tables_say_whether_and_when_it_was_confirmed_and_not_by_whom(tmp_path: Path) -> None:
    for session, told in ((signed(tmp_path), ("yes", "2026-03-02")), (exported(tmp_path), ("no", ""))):
        made = tables.tables([session]) | tables.redcap_tables([session])
        for name in (tables.TABLE, tables.RECORDS):
            assert {(row["confirmed"], row["confirmed_on"]) for row in rows(made[name])} == {told}
        assert not [name for name in (b"Luchs", b"Dachs", b"Larger on") if name in b"".join(made.values())]


def test_a_session_is_confirmed_once_every_measured_boundary_is() -> None:
    curves = {name: np.full((4, 3), float(number)) for number, name in enumerate(("left", "right"))}
    measured = [SimpleNamespace(name=name, boundary_world=curve) for name, curve in curves.items()]
    seen = {
        name: Attribution(
            confirmation=CurveConfirmation(
                by=f"Eye {name}", at=f"2026-11-2{number}T10:00:00Z", curve=curve_digest(curve)
            )
        )
        for number, (name, curve) in enumerate(curves.items())
    }
    newest = confirmed(seen, measured)  # type: ignore[arg-type]
    assert newest is not None
    assert (newest.by, newest.at.isoformat()) == ("Eye right", "2026-11-21T10:00:00+00:00")
    assert confirmed({"left": seen["left"]}, measured) is None  # type: ignore[arg-type]
    measured[1].boundary_world = curves["left"]  # another curve than the one that was looked at
    assert confirmed(seen, measured) is None  # type: ignore[arg-type]
    assert confirmed(seen, []) is None


def test_a_width_has_one_name_and_its_definition_everywhere(tmp_path: Path) -> None:
    """The extent of the boundary is no base width: its code, title and definition are others."""
    widths = (
        *(("base_width_straight", "base width, straight", 156.1, "straight"),),
        *(("boundary_width", "Boundary width", 140.3, "extent"),),
    )
    measured = tuple(
        Quantity(code=code, title=title, side="left", value=value, unit="mm", method=method)
        for code, title, value, method in widths
    )
    shown = exported(tmp_path, quantities=measured)
    meanings = {row["name"]: row["meaning"] for row in rows(tables.codebook([shown])) if row["of"] == "code"}
    assert "medial" in meanings["base_width_straight"]
    assert "base" in meanings["boundary_width"]
    fields = {row["Variable / Field Name"] for row in rows(tables.dictionary())}
    assert fields >= {"base_width_straight_left", "boundary_width_left", "boundary_height_right"}
    assert not {name for name in fields if name.startswith(("base_width_left", "base_height"))}
    record = rows(tables.records([shown]))[0]
    assert (record["base_width_straight_left"], record["boundary_width_left"]) == ("156.1", "140.3")
    codes = {
        row["code"]["coding"][0]["code"]: row["valueQuantity"]["value"]
        for row in resources(bundle(shown, ANNA, release="R4"), "Observation")
    }
    assert codes.items() >= {"base_width_straight": 156.1, "boundary_width": 140.3}.items()
