"""Texts that other systems must take are checked in the clinic's own forms."""

from collections.abc import Callable
from pathlib import Path

import pytest
from django.test import Client
from django.urls import reverse
from tests.clinic_forms import refused

from mammometry.base.errors import SettingsError
from mammometry.clinic.accounts import add_person
from mammometry.clinic.config import ClinicError, new_clinic, read_config
from mammometry.clinic.models import Destination, Patient, Person
from mammometry.clinic.roles import Role

ANNA = {"family_name": "Größe", "given_name": "Åse", "born": "1971-05-04", "record_number": "KIS-1", "note": ""}


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"record_number": "1\\2"}, "backslash"),
        ({"record_number": "1\x1b2"}, "control character"),
        ({"family_name": "A\\B"}, "backslash"),
        ({"family_name": "A^B"}, "^"),
        ({"given_name": "A=B"}, "^"),
        ({"family_name": "M" * 65}, "Found 65 letters."),
        ({"family_name": "M" * 40, "given_name": "A" * 30}, "70 letters"),
        ({"family_name": "Moser\u202e"}, "U+202E RIGHT-TO-LEFT OVERRIDE"),
        ({"given_name": "A\ue000"}, "U+E000"),
        ({"record_number": "1\u200b2"}, "U+200B ZERO WIDTH SPACE"),
        ({"family_name": "M\ufffdller"}, "position 2"),
    ],
)
@pytest.mark.requirement("R-IN-5")
def test_a_patient_is_entered_as_dicom_allows(
    client_of: Callable[..., Client], changed: dict[str, str], sentence: str
) -> None:
    client = client_of(Role.TECHNICIAN)
    wrong = refused(client.post(reverse("patient-new"), {**ANNA, **changed}))
    assert set(wrong) & {*changed, "__all__"}
    assert sentence in " ".join(wrong.values())
    assert not Patient.objects.exists()
    client.post(reverse("patient-new"), ANNA)
    assert Patient.objects.get().name == "Größe, Åse"


def test_who_confirms_has_a_name_that_dicom_allows(client_of: Callable[..., Client]) -> None:
    client = client_of(Role.ADMINISTRATOR)
    for name, sentence in (
        ("A" * 70, "Found 70 letters."),
        ("A\\B", "backslash"),
        ("Dr. \u202eB", "U+202E"),
    ):
        table = {"username": "eva", "full_name": name, "roles": [Role.CLINICIAN.value], "is_active": "on"}
        assert sentence in refused(client.post(reverse("person-new"), table))["full_name"]
    with pytest.raises(ClinicError, match=r"name: .*71 letters"):
        add_person("eva", [Role.CLINICIAN], full_name="A" * 70)
    assert not Person.objects.filter(username="eva").exists()


def test_an_archive_knows_us_by_a_title_that_dicom_allows(client_of: Callable[..., Client]) -> None:
    table = {"name": "PACS", "kind": "dicom", "address": "PACS@10.0.0.5:104", "own_title": "MÜHLE"}
    assert (
        "Found non-ASCII letters."
        in client_of(Role.ADMINISTRATOR).post(reverse("destination-new"), table).content.decode()
    )
    assert not Destination.objects.exists()


@pytest.mark.parametrize("name", ["A\\B", "A" * 65, "A\x07"])
def test_a_clinic_has_a_name_that_dicom_allows(tmp_path: Path, name: str) -> None:
    with pytest.raises(SettingsError, match=r"name: .*backslash"):
        new_clinic(tmp_path / "clinic", name=name)
    assert not (tmp_path / "clinic").exists()


def test_a_clinics_name_is_checked_where_it_was_edited(tmp_path: Path) -> None:
    new_clinic(tmp_path / "clinic", name="Clinic")
    file = tmp_path / "clinic" / "clinic.toml"
    file.write_text(file.read_text().replace('"Clinic"', f'"{"A" * 65}"'))
    with pytest.raises(SettingsError, match=r"^clinic\.toml, name: .*64 letters"):
        read_config(tmp_path / "clinic")
