"""Measurements as a Structured Report: TID 1500, by highdicom."""

from __future__ import annotations

import datetime
import warnings
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from pydicom import Dataset

from mammometry.base.notices import Notice
from mammometry.base.notices.words import words_of
from mammometry.hospital import codes
from mammometry.hospital.codes import Coded, uid
from mammometry.hospital.dicom.frame import Study, coded, describe, finished
from mammometry.hospital.exported import Quantity, Side, person_name
from mammometry.report.content import Signed

if TYPE_CHECKING:
    from highdicom.sr import CodedConcept

_MEANING = 64  # characters of a code's meaning, PS3.5, LO
_TITLES: dict[Side, str] = {"left": "Left breast", "right": "Right breast", "model": "Model", "": "Both sides"}


def report(study: Study, evidence: Sequence[Dataset], *, series: int) -> list[Dataset]:
    """The measurements as one Comprehensive 3D SR. Empty if there are none.

    Args:
        study: the exported study.
        evidence: the measured objects of the same study, one or more.
        series: number of its series.
    """
    from highdicom.sr import (
        Comprehensive3DSR,
        DeviceObserverIdentifyingAttributes,
        LanguageOfContentItemAndDescendants,
        MeasurementReport,
        ObservationContext,
        ObserverContext,
    )
    from pydicom.sr.codedict import codes as dicom

    exported = study.exported
    if not (exported.quantities or exported.absent) or not evidence:
        return []
    observer = ObserverContext(
        observer_type=dicom.DCM.Device,
        observer_identifying_attributes=DeviceObserverIdentifyingAttributes(
            uid=uid("device", "mammometry"), name="mammometry", manufacturer_name="mammometry", model_name="mammometry"
        ),
    )
    content = MeasurementReport(
        observation_context=ObservationContext(observer_device_context=observer),
        procedure_reported=_concept(codes.PHOTOGRAMMETRY),
        imaging_measurements=list(_groups(study)),
        title=dicom.DCM.ImagingMeasurementReport,
        language_of_content_item_and_descendants=LanguageOfContentItemAndDescendants(_english()),
    )
    conclusions = exported.clinical.conclusions[:1]
    content[0].ContentSequence.extend(_conclusions(conclusions))
    content[0].ContentSequence.extend(_warnings(exported.notices))
    confirmed = exported.clinical.confirmed
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The string .* is unlikely to represent")  # a name of one part
        made = Comprehensive3DSR(
            evidence=evidence,
            content=content,
            series_instance_uid=study.series_uid("measurements"),
            series_number=series,
            sop_instance_uid=uid("unfinished"),
            instance_number=1,
            manufacturer="mammometry",
            is_complete=True,
            is_final=exported.is_final,
            is_verified=confirmed is not None,
            verifying_observer_name=None if confirmed is None else person_name(confirmed.by),
            verifying_organization=None if confirmed is None else exported.organization or "not stated",
            series_description="Measurements",
        )
    describe(made, study)
    # highdicom uses the current time.
    for equipment in made.get("ContributingEquipmentSequence", ()):
        del equipment.ContributionDateTime
    if confirmed is not None:
        made.VerifyingObserverSequence[0].VerificationDateTime = _moment(confirmed)
    made.SeriesDate, made.SeriesTime = made.ContentDate, made.ContentTime
    return [finished(made)]


def _conclusions(conclusions: Sequence[Signed]) -> Iterator[Any]:
    """The conclusion, its author and time. Empty if there is none."""
    from highdicom.sr import (
        ContainerContentItem,
        ContentSequence,
        PnameContentItem,
        RelationshipTypeValues,
        TextContentItem,
    )

    for conclusion in conclusions:
        item = TextContentItem(
            name=_concept(codes.CONCLUSION), value=conclusion.text, relationship_type=RelationshipTypeValues.CONTAINS
        )
        item.add_new("ObservationDateTime", "DT", _moment(conclusion))
        author = PnameContentItem(
            name=_concept(codes.PERSON), value=person_name(conclusion.by),
            relationship_type=RelationshipTypeValues.HAS_OBS_CONTEXT,
        )  # fmt: skip
        item.ContentSequence = ContentSequence([author])
        whole = ContainerContentItem(
            name=_concept(codes.CONCLUSIONS), relationship_type=RelationshipTypeValues.CONTAINS
        )
        whole.ContentSequence = ContentSequence([item])
        yield whole


def _warnings(notices: Sequence[Notice]) -> Iterator[Any]:
    """Warnings about the volumes: code and words."""
    from highdicom.sr import RelationshipTypeValues, TextContentItem

    for notice in notices:
        name = codes.own(notice.code, f"Warning: {notice.code.replace('-', ' ')}")
        yield TextContentItem(
            name=_concept(name), value=words_of(notice), relationship_type=RelationshipTypeValues.CONTAINS
        )


def _moment(signed: Signed) -> str:
    return f"{signed.at.astimezone(datetime.UTC):%Y%m%d%H%M%S}+0000"


def _groups(study: Study) -> Iterator[Any]:
    """One group of measurements per side (TID 1501)."""
    from highdicom.sr import (
        AlgorithmIdentification,
        FindingSite,
        MeasurementsAndQualitativeEvaluations,
        QualitativeEvaluation,
        TrackingIdentifier,
    )

    exported = study.exported
    absent = {absence.side: absence for absence in exported.absent}
    for side, title in _TITLES.items():
        mine = [quantity for quantity in exported.quantities if quantity.side == side]
        if not mine and side not in absent:
            continue
        sites = None
        if side in codes.SIDES:
            sites = [FindingSite(_concept(codes.BREAST), laterality=_concept(codes.SIDES[side]))]
        why = None
        if side in absent:
            reason = codes.own(absent[side].kind, codes.NO_VOLUMES[absent[side].kind])
            why = [QualitativeEvaluation(_concept(codes.NO_VOLUME), _concept(reason))]
        yield MeasurementsAndQualitativeEvaluations(
            tracking_identifier=TrackingIdentifier(uid=uid("side", study.uid, side), identifier=title),
            algorithm_id=AlgorithmIdentification(name="mammometry", version=exported.software),
            finding_sites=sites,
            measurements=[measurement for quantity in mine for measurement in _measurements(quantity)],
            qualitative_evaluations=why,
        )


def _measurements(quantity: Quantity) -> Iterator[Any]:
    """One number with its uncertainty, then the limits of its interval, for which TID 300 has no field."""
    yield _measurement(quantity, codes.own(quantity.code, quantity.title), quantity.value, with_uncertainty=True)
    if quantity.interval_95 is not None:
        for limit, value in zip((codes.LOWER, codes.UPPER), quantity.interval_95, strict=True):
            words = f"{quantity.title}: {limit.meaning[0].lower()}{limit.meaning[1:]}"
            yield _measurement(quantity, codes.own(f"{quantity.code}.{limit.value}", words), value)


def _measurement(quantity: Quantity, name: Coded, value: float, *, with_uncertainty: bool = False) -> Any:
    from highdicom.sr import Measurement, MeasurementProperties

    properties = None
    if with_uncertainty and quantity.interval_95 is not None:
        low, high = quantity.interval_95
        properties = MeasurementProperties(
            upper_measurement_uncertainty=_rounded(high - value), lower_measurement_uncertainty=_rounded(value - low)
        )
    elif with_uncertainty and quantity.sigma is not None:
        sigma = _rounded(quantity.sigma)
        properties = MeasurementProperties(upper_measurement_uncertainty=sigma, lower_measurement_uncertainty=sigma)
    for item in properties or ():  # highdicom gives them no unit
        item.MeasuredValueSequence[0].MeasurementUnitsCodeSequence[0] = coded(codes.UNITS[quantity.unit])
    made = Measurement(
        name=_concept(name),
        value=_rounded(value),
        unit=_concept(codes.UNITS[quantity.unit]),
        method=_concept(codes.own(quantity.method, codes.METHODS[quantity.method])),
        properties=properties,
    )
    made[0].ContentSequence.extend(_modifiers(quantity))
    if with_uncertainty:
        made[0].ContentSequence.extend(_notes(quantity))
    return made


def _modifiers(quantity: Quantity) -> Iterator[Any]:
    """The kind of quantity, and the wall, as concept modifiers."""
    from highdicom.sr import CodeContentItem, RelationshipTypeValues

    modifies = RelationshipTypeValues.HAS_CONCEPT_MOD
    kind = _concept(codes.own("kind", "Kind of quantity"))
    yield CodeContentItem(name=kind, value=_concept(codes.KINDS[quantity.unit]), relationship_type=modifies)
    if quantity.wall:
        yield CodeContentItem(
            name=_concept(codes.WALL), value=_concept(codes.own(quantity.wall, quantity.wall)),
            relationship_type=modifies,
        )  # fmt: skip


def _notes(quantity: Quantity) -> Iterator[Any]:
    """Origin of the boundary, and explanation of the uncertainties, as text."""
    if quantity.boundary:
        yield _text("boundary", "How the boundary was found", quantity.boundary_words)
    if quantity.sigma is not None:
        words = "Uncertainties are standard uncertainties."
    elif quantity.interval_95 is not None:
        words = f"Uncertainties reach to the limits of the 95 % interval. {quantity.note}"
    else:
        return
    yield _text("meaning", "What the uncertainty means", words)


def _text(code: str, name: str, words: str) -> Any:
    from highdicom.sr import RelationshipTypeValues, TextContentItem

    return TextContentItem(
        name=_concept(codes.own(code, name)), value=words, relationship_type=RelationshipTypeValues.HAS_PROPERTIES
    )


def _concept(concept: Coded) -> CodedConcept:
    from highdicom.sr import CodedConcept

    return CodedConcept(value=concept.value, scheme_designator=concept.scheme, meaning=concept.meaning[:_MEANING])


def _english() -> CodedConcept:
    return _concept(Coded(value="en", scheme="RFC5646", meaning="English"))


def _rounded(value: float) -> float:
    """Six decimals: DICOM's decimal strings have 16 characters."""
    return round(float(value), 6)
