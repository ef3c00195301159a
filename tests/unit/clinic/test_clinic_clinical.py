"""What the clinic knows of a visit beside its numbers: operations, postures, consents, conclusions."""

import datetime

import pytest
from django.utils import timezone

from mammometry.clinic.clinical_facts import clinical_of, operation_words
from mammometry.clinic.models import Conclusion, Confirmation, Measurement, Operation, Person, Visit


@pytest.fixture
def surgeon(clinic: object) -> Person:
    return Person.objects.create(username="sergio", full_name="Dr. Sergio Surgeon", roles=["clinician"])


def operated(visit: Visit, days: int, **of_operation: object) -> Operation:
    """An operation some days before a visit; after it where the number is negative."""
    day = timezone.localtime(visit.taken_at).date() - datetime.timedelta(days=days)
    return Operation.objects.create(
        **{"patient": visit.patient, "kind": "graft", "side": "left", "day": day, **of_operation}  # type: ignore[arg-type]
    )


def test_a_report_is_given_what_the_database_knows(visit: Visit, surgeon: Person) -> None:
    visit.occasion, visit.posture = Visit.Occasion.WEEKS_6, Visit.Posture.STANDING
    visit.save()
    old = Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
    Confirmation.objects.create(measurement=old, by=surgeon)
    clinical = clinical_of(visit)
    assert (clinical.patient, clinical.record) == ("Zypernkatze, Quirina", "KIS-4711")
    assert clinical.born == datetime.date(1980, 2, 29) or str(clinical.born) == "1980-02-29"
    assert (clinical.occasion, clinical.posture) == ("6 weeks after", "standing")
    assert clinical.confirmed is not None
    assert clinical.confirmed.by == "Dr. Sergio Surgeon"
    Measurement.objects.create(visit=visit, digest="2", made_at=timezone.now(), software="1")
    assert clinical_of(visit).confirmed is None  # the confirmation was of the earlier result
    for text in ("Symmetrical.", "Not quite symmetrical."):
        Conclusion.objects.create(visit=visit, measurement=old, text=text, by=surgeon)
    assert [each.text for each in clinical_of(visit).conclusions] == ["Not quite symmetrical.", "Symmetrical."]


def test_operations_after_the_visit_are_not_told(visit: Visit) -> None:
    operated(visit, 60, volume_cc=120.0)
    operated(visit, 20, kind="reduction", side="both", resected_g=310.5, words="inferior pedicle")
    operated(visit, -1, kind="implant")
    day = (timezone.localtime(visit.taken_at).date() - datetime.timedelta(days=20)).isoformat()
    told = clinical_of(visit).operations
    assert len(told) == 2
    assert told[0] == f"Reduction or lift, both sides, {day}, 310.5 g taken out each side, inferior pedicle"
    assert told[1].endswith(", 120 cc of fat injected")


def test_a_visit_before_the_operation_of_its_own_day_does_not_show_it(visit: Visit) -> None:
    operation = operated(visit, 0, kind="implant", volume_cc=300.0)
    assert clinical_of(visit).operations == (operation_words(operation),)
    visit.occasion = Visit.Occasion.BEFORE
    assert clinical_of(visit).operations == ()


def test_codes_of_operations_are_in_pydicoms_dictionary() -> None:
    from pydicom.sr._concepts_dict import concepts

    from mammometry.hospital.codes import OPERATIONS

    known = {code for codes in concepts["SCT"].values() for code in codes}
    assert set(OPERATIONS) == set(Operation.Kind.values)
    coded = [code for code in OPERATIONS.values() if code is not None]
    assert coded
    assert {code.value for code in coded} <= known
