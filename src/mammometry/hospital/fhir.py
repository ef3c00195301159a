"""Measurements as a FHIR bundle, R4 or R5.

A DiagnosticReport, an Observation per number, a Procedure per operation, and a Provenance for the confirmation and the
conclusion. The report is final once both exist. The bundle is a transaction of PUTs with ids derived from content:
sending it twice changes nothing.
"""

import importlib
import json
from collections.abc import Iterator
from typing import Any, Literal

from mammometry.base.notices.words import concerns, words_of
from mammometry.hospital import codes
from mammometry.hospital.codes import Coded, identifier
from mammometry.hospital.exported import (
    Absent,
    Exported,
    ExportedOperation,
    ExportedPatient,
    Quantity,
    Side,
    as_patient_id,
)
from mammometry.report.content import Signed

Release = Literal["R4", "R5"]
_PACKAGES = {"R4": "fhir.resources.R4B", "R5": "fhir.resources"}
"""R4B has the same resources as R4, as far as they are used here."""
_SYSTEMS = {
    "SCT": codes.SCT_SYSTEM,
    "UCUM": codes.UCUM_SYSTEM,
    codes.OWN_SCHEME: codes.OWN_SYSTEM,
    "LN": "http://loinc.org",
}
_REPORT = Coded(value="18748-4", scheme="LN", meaning="Diagnostic imaging study")
_PARTICIPANTS = "http://terminology.hl7.org/CodeSystem/provenance-participant-type"
_RESEARCH = "For research use only. mammometry is not a certified medical device."
_SEXES = {"F": "female", "M": "male", "O": "other"}


def bundle(exported: Exported, patient: ExportedPatient = ExportedPatient(), *, release: Release = "R4") -> bytes:
    """One session as JSON, validated by fhir.resources.

    Args:
        exported: the content. If it is de-identified, the patient is left out.
        patient: as in other systems. Without an id, the session's subject is used.
        release: of FHIR.
    """
    if exported.deidentified:
        patient = ExportedPatient(id=f"anonymous-{exported.source[:12]}")
    elif not patient.id:
        patient = ExportedPatient(
            id=as_patient_id(exported.subject), name=patient.name, born=patient.born, sex=patient.sex
        )
    who = _patient(patient)
    subject = {"reference": f"Patient/{who['id']}"}
    about = {"subject": subject} | _moments(exported)
    seed = (exported.source, patient.id)
    observations = [_observation(quantity, exported, about, seed) for quantity in exported.quantities]
    observations += [_nothing(absence, exported, about, seed) for absence in exported.absent]
    clinical = exported.clinical
    conclusion = clinical.conclusions[0] if clinical.conclusions else None
    report: dict[str, Any] = {
        "resourceType": "DiagnosticReport",
        "id": identifier("report", *seed),
        "status": "final" if exported.is_final else "preliminary",
        "code": _concept(_REPORT, codes.PHOTOGRAMMETRY.meaning),
        **about,
        "result": [{"reference": f"Observation/{observation['id']}"} for observation in observations],
        "conclusion": f"{conclusion.text}\n{_RESEARCH}" if conclusion is not None else _RESEARCH,
    }
    signatures = []
    for field, role, signed in (
        ("performer", "verifier", clinical.confirmed),
        ("resultsInterpreter", "author", conclusion),
    ):
        if signed is not None:
            report[field] = [{"display": signed.by}]
            signatures.append(_provenance(role, signed, f"DiagnosticReport/{report['id']}", seed))
    operations = [_operation(operation, subject, seed, release) for operation in exported.operations]
    made = {
        "resourceType": "Bundle",
        "id": identifier("bundle", *seed),
        "type": "transaction",
        "entry": [_entry(resource) for resource in (who, *operations, *observations, report, *signatures)],
    }
    package = importlib.import_module(f"{_PACKAGES[release]}.bundle")
    package.Bundle.model_validate(made)  # raises only on our own defects
    return (json.dumps(made, ensure_ascii=False, indent=1) + "\n").encode()


def _patient(patient: ExportedPatient) -> dict[str, Any]:
    made: dict[str, Any] = {"resourceType": "Patient", "id": identifier("patient", patient.id)}
    if patient.id:
        made["identifier"] = [{"value": patient.id}]
    if patient.name:
        family, _, given = patient.name.partition("^")
        parts = given.replace("^", " ").split()
        made["name"] = [{"family": family} | ({"given": parts} if parts else {})]
    if patient.sex:
        made["gender"] = _SEXES[patient.sex]
    if patient.born is not None:
        made["birthDate"] = patient.born.isoformat()
    return made


def _observation(
    quantity: Quantity, exported: Exported, about: dict[str, Any], seed: tuple[str, str]
) -> dict[str, Any]:
    made = _begun(quantity.name, exported, about, seed)
    made["code"] = _concept(codes.own(quantity.code, quantity.title))
    made |= _site(quantity.side)
    made["valueQuantity"] = _amount(quantity.value, quantity.unit)
    method = codes.own(quantity.method, codes.METHODS[quantity.method])
    words = [method.meaning, quantity.boundary and f"Boundary: {quantity.boundary_words}"]
    made["method"] = _concept(method, ". ".join(filter(None, words)))
    components = list(_components(quantity))
    if components:
        made["component"] = components
    warned = (notice for notice in exported.notices if quantity.boundary and concerns(notice, quantity.side))
    if notes := [*filter(None, [quantity.note]), *map(words_of, warned)]:
        made["note"] = [{"text": words} for words in notes]
    return made


def _provenance(role: str, signed: Signed, target: str, seed: tuple[str, str]) -> dict[str, Any]:
    """Verifier or author of the report, and the time."""
    return {
        "resourceType": "Provenance",
        "id": identifier("provenance", *seed, role),
        "target": [{"reference": target}],
        "recorded": signed.at.isoformat(),
        "agent": [
            {
                "type": {"coding": [{"system": _PARTICIPANTS, "code": role, "display": role.capitalize()}]},
                "who": {"display": signed.by},
            }
        ],
    }


def _operation(
    operation: ExportedOperation, subject: dict[str, str], seed: tuple[str, str], release: Release
) -> dict[str, Any]:
    code = codes.OPERATIONS.get(operation.kind)
    sides = ("left", "right") if operation.side == "both" else (operation.side,)
    return {
        "resourceType": "Procedure",
        "id": identifier("procedure", seed[1], operation.day.isoformat(), operation.sentence),
        "status": "completed",
        "code": {"text": operation.title} if code is None else _concept(code, operation.title),
        "subject": subject,
        "performedDateTime" if release == "R4" else "occurrenceDateTime": operation.day.isoformat(),
        "bodySite": [_concept(codes.SITES[side]) for side in sides],
        "note": [{"text": operation.sentence}],
    }


def _nothing(side: Absent, exported: Exported, about: dict[str, Any], seed: tuple[str, str]) -> dict[str, Any]:
    """A side without a volume: the value is absent, with the reason."""
    made = _begun(f"volume_{side.side}", exported, about, seed)
    made["code"] = _concept(codes.own("volume", "Volume"))
    made |= _site(side.side)
    made["dataAbsentReason"] = _concept(codes.own(side.kind, codes.NO_VOLUMES[side.kind]), side.why)
    return made


def _begun(name: str, exported: Exported, about: dict[str, Any], seed: tuple[str, str]) -> dict[str, Any]:
    return {
        "resourceType": "Observation",
        "id": identifier("observation", *seed, name),
        "status": "preliminary" if exported.clinical.confirmed is None else "final",
        **about,
        "device": {"display": f"mammometry {exported.software}"},
    }


def _components(quantity: Quantity) -> Iterator[dict[str, Any]]:
    if quantity.interval_95 is not None:
        for limit, value in zip((codes.LOWER, codes.UPPER), quantity.interval_95, strict=True):
            yield {"code": _concept(limit), "valueQuantity": _amount(value, quantity.unit)}
    if quantity.sigma is not None:
        yield {"code": _concept(codes.SIGMA), "valueQuantity": _amount(quantity.sigma, quantity.unit)}
    if quantity.wall:
        wall = codes.own(quantity.wall, quantity.wall)
        yield {"code": _concept(codes.WALL), "valueCodeableConcept": _concept(wall, quantity.wall_definition)}


def _moments(exported: Exported) -> dict[str, str]:
    moments = {}
    if exported.taken is not None:
        moments["effectiveDateTime"] = exported.taken.isoformat()
    if exported.made is not None:
        moments["issued"] = exported.made.isoformat()
    return moments


def _site(side: Side) -> dict[str, Any]:
    return {"bodySite": _concept(codes.SITES[side])} if side in codes.SITES else {}


def _amount(value: float, unit: str) -> dict[str, Any]:
    return {"value": round(float(value), 4), "unit": unit, "system": codes.UCUM_SYSTEM, "code": unit}


def _concept(concept: Coded, text: str = "") -> dict[str, Any]:
    coding = {"system": _SYSTEMS[concept.scheme], "code": concept.value, "display": concept.meaning}
    return {"coding": [coding], "text": text or concept.meaning}


def _entry(resource: dict[str, Any]) -> dict[str, Any]:
    where = f"{resource['resourceType']}/{resource['id']}"
    return {"fullUrl": f"urn:uuid:{resource['id']}", "resource": resource, "request": {"method": "PUT", "url": where}}
