"""Forms of the clinic's pages."""

import datetime
from collections.abc import Mapping
from typing import Any, Protocol

from django import forms
from django.utils import timezone

from mammometry.clinic.models import Conclusion, Consent, Operation, Patient, Person, Rig, Visit
from mammometry.clinic.record_form import RecordForm
from mammometry.clinic.records.comparability import is_between
from mammometry.clinic.records.search import Duplicates, date_questions, duplicates
from mammometry.clinic.roles import Role
from mammometry.hospital.codes import Representation, text_fault
from mammometry.hospital.exported import person_name

DAY_AND_TIME = forms.DateTimeInput(attrs={"type": "datetime-local"}, format="%Y-%m-%dT%H:%M")
"""Widget of a visit's day and time."""


def require_dicom_text(text: str, representation: Representation) -> None:
    """Refuse text that DICOM does not allow, before it is sent.

    Raises:
        ValidationError: states the fault and what is allowed.
    """
    if (fault := text_fault(text, representation)) is not None:
        found, allowed = fault
        raise forms.ValidationError(f"Found {found}. The hospital’s systems allow {allowed}.")


class PatientForm(RecordForm):
    """Identity of a patient."""

    class Meta:
        model = Patient
        fields = ("family_name", "given_name", "born", "record_number", "note")
        labels = {"born": "Date of birth", "record_number": "Record number"}  # noqa: RUF012
        help_texts = {"record_number": "As in the hospital's own system."}  # noqa: RUF012
        widgets = {  # noqa: RUF012
            "born": forms.DateInput(attrs={"type": "date"}, format="%Y-%m-%d"),
            "note": forms.Textarea(attrs={"rows": 3}),
            "family_name": forms.TextInput(attrs={"autocomplete": "off"}),
            "given_name": forms.TextInput(attrs={"autocomplete": "off"}),
            "record_number": forms.TextInput(attrs={"autocomplete": "off"}),
        }

    duplicates: Duplicates | None = None
    """Records that may be of the same patient. None if there are none, or they have not been searched yet."""

    def validate_unique(self) -> None:
        """Show an existing record of the same patient before another one is created.

        The user may continue if the record number is different.
        """
        if self.errors:
            return
        similar, changed = duplicates(self.instance), set(self.changed_data)
        if similar.same_number is not None and "record_number" in changed:
            self.add_error("record_number", "There is already a patient with this record number.")
        elif similar.same_person and changed & {"family_name", "given_name", "born"} and "anyway" not in self.data:
            self.add_error(None, "There is a patient of this name and birthday. Is it the same one?")
        else:
            return
        self.duplicates = similar

    def clean_record_number(self) -> str:
        """Refuse ids that other systems do not accept."""
        number: str = self.cleaned_data["record_number"]
        require_dicom_text(number, "LO")
        return number

    def clean_family_name(self) -> str:
        """Refuse names that other systems do not accept."""
        return _clean_name(self.cleaned_data["family_name"])

    def clean_given_name(self) -> str:
        """Refuse names that other systems do not accept, alone or together with the family name."""
        given = _clean_name(self.cleaned_data["given_name"])
        if text_fault(name := f"{self.cleaned_data.get('family_name', '')}^{given}", "PN") is not None:
            raise forms.ValidationError(
                f"Both names have {len(name) - 1} letters together. The hospital’s systems allow 63: shorten one."
            )
        return given

    def clean_born(self) -> datetime.date | None:
        """Refuse future days."""
        born: datetime.date | None = self.cleaned_data["born"]
        if born is not None and not FIRST_DAY <= born <= timezone.localdate():
            raise forms.ValidationError("Enter a day between 1900 and today.")
        return born


def _clean_name(name: str) -> str:
    if set(name) & set("^="):
        raise forms.ValidationError("A name cannot contain ^ or =: they separate its parts in the hospital’s systems.")
    require_dicom_text(name, "LO")
    return name


class VisitForm(RecordForm):
    """Patient and rig of a visit."""

    class Meta:
        model = Visit
        fields = ("patient", "rig", "taken_at", "subject_kind", "occasion", "posture", "note")
        labels = {"taken_at": "Day and time", "subject_kind": "What is photographed"}  # noqa: RUF012
        widgets = {  # noqa: RUF012
            "patient": forms.HiddenInput(),
            "taken_at": DAY_AND_TIME,
            "note": forms.Textarea(attrs={"rows": 2}),
        }

    questions: tuple[str, ...] = ()

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        rig, kind = (self.fields[name] for name in ("rig", "subject_kind"))
        assert isinstance(rig, forms.ModelChoiceField)
        assert isinstance(kind, forms.ChoiceField)
        rig.empty_label = "Choose"
        rigs = list(Rig.objects.filter(active=True)[:2])
        rig.queryset = Rig.objects.filter(active=True)
        if len(rigs) == 1:
            rig.initial = rigs[0]
        kind.choices = [("torso", "A patient"), ("model", "A model on a table")]
        name_empty_choices(self.fields)
        self.fields["posture"].initial = Visit.Posture.LEANING

    def clean(self) -> dict[str, Any]:
        """Ask the user to confirm an unusual day, and remove a model's posture."""
        values: dict[str, Any] = super().clean() or self.cleaned_data
        ask_about_day(self, values.get("rig"))
        if values.get("subject_kind") == Visit.Subject.MODEL:
            values |= {"occasion": "", "posture": ""}
        return values


def name_empty_choices(fields: Mapping[str, forms.Field]) -> None:
    """Mark occasion and posture, if present, as optional."""
    for name, choices in (("occasion", Visit.Occasion.choices), ("posture", Visit.Posture.choices)):
        field = fields.get(name)
        if field is None:
            continue
        assert isinstance(field, forms.ChoiceField)
        field.choices = [("", "not entered"), *choices]


class PersonForm(RecordForm):
    """A person who logs in, with checkboxes for roles."""

    roles = forms.MultipleChoiceField(
        choices=[
            (Role.TECHNICIAN, "Technician: photographs and measures"),
            (Role.CLINICIAN, "Clinician: also draws, confirms and compares"),
            (Role.RESEARCHER, "Researcher: sees pseudonyms and figures, no names"),
            (Role.ADMINISTRATOR, "Administrator: manages people, rigs, backups and the audit; sees no results"),
        ],
        widget=forms.CheckboxSelectMultiple,
        error_messages={"required": "Tick at least one role."},
    )

    class Meta:
        model = Person
        fields = ("username", "full_name", "email", "roles", "is_active")
        labels = {  # noqa: RUF012
            "username": "Name for the login",
            "full_name": "Full name",
            "email": "E-mail address",
            "is_active": "May log in",
        }
        help_texts = {  # noqa: RUF012
            "username": "Letters, digits and @ . + - _",
            "full_name": "Name on pages and reports.",
            "email": "Only for the hospital’s own login, which identifies people by it.",
            "is_active": "",
        }
        error_messages = {"username": {"unique": "This name is already taken."}}  # noqa: RUF012

    def __init__(self, *args: Any, own: bool = False, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._own = own
        self.fields["email"].required = False

    def clean_full_name(self) -> str:
        """Refuse names that other systems do not accept, for people who confirm results."""
        name: str = self.cleaned_data["full_name"]
        require_dicom_text(name, "LO")
        if text_fault(person_name(name), "PN") is not None:
            raise forms.ValidationError(f"Found {len(name)} letters. The hospital’s systems allow 63.")
        return name

    def clean(self) -> dict[str, Any]:
        """Prevent administrators from locking themselves out."""
        values: dict[str, Any] = super().clean() or self.cleaned_data
        if self._own and (Role.ADMINISTRATOR not in values.get("roles", ()) or not values.get("is_active")):
            raise forms.ValidationError(
                "You cannot remove your own administrator role or login. Another administrator can do it."
            )
        return values


class _Asking(Protocol):
    """A form that asks the user to confirm an unusual day of a visit."""

    questions: tuple[str, ...]
    data: Any
    cleaned_data: dict[str, Any]

    def add_error(self, field: str | None, error: Any) -> None: ...


FIRST_DAY = datetime.date(1900, 1, 1)
"""Earliest date in a clinic."""


def ask_about_day(form: _Asking, rig: Rig | None) -> None:
    """Ask for confirmation if a visit's day is in the future or before the rig's first calibration.

    A second button confirms the day. Days before 1900 or after tomorrow are always refused.
    """
    taken_at = form.cleaned_data.get("taken_at")
    if taken_at is None:
        return
    if not FIRST_DAY <= timezone.localdate(taken_at) <= timezone.localdate() + datetime.timedelta(days=1):
        form.add_error("taken_at", "Enter a day between 1900 and tomorrow.")
        return
    if "anyway" in form.data:
        return
    form.questions = tuple(date_questions(taken_at, rig))
    for question in form.questions:
        form.add_error("taken_at", question)


_MOST_CC = 5000.0  # the largest expanders hold 1,500 cc
_MOST_G = 10_000.0  # gigantomastia: several kg on each side


def _day() -> forms.DateInput:
    return forms.DateInput(attrs={"type": "date"}, format="%Y-%m-%d")


def _number(most: float) -> forms.NumberInput:
    return forms.NumberInput(attrs={"min": "0", "max": f"{most:g}", "step": "any", "inputmode": "decimal"})


class OperationForm(RecordForm):
    """An operation on a breast."""

    class Meta:
        model = Operation
        fields = ("kind", "side", "day", "volume_cc", "resected_g", "words")
        labels = {  # noqa: RUF012
            "kind": "Operation",
            "volume_cc": "Volume, cc",
            "resected_g": "Tissue removed, g",
            "words": "In words",
        }
        help_texts = {  # noqa: RUF012
            "volume_cc": "Of the implant, of the expander’s whole filling, or of the injected fat; each side.",
            "resected_g": "Weight, each side.",
            "words": "The flap, the implant’s type, or another operation.",
        }
        widgets = {"day": _day(), "volume_cc": _number(_MOST_CC), "resected_g": _number(_MOST_G)}  # noqa: RUF012

    def clean_day(self) -> datetime.date:
        """Refuse future days, and those before the patient was born."""
        day: datetime.date = self.cleaned_data["day"]
        born = self.instance.patient.born
        if not (born or FIRST_DAY) <= day <= timezone.localdate():
            first = "1900" if born is None else "the patient’s birth"
            raise forms.ValidationError(f"Enter a day between {first} and today.")
        return day

    def clean_words(self) -> str:
        """Refuse control characters, which other systems do not accept."""
        words: str = self.cleaned_data["words"]
        require_dicom_text(words, "UT")
        return words

    def clean_volume_cc(self) -> float | None:
        """Refuse impossible volumes."""
        return self._within("volume_cc", _MOST_CC, "cc")

    def clean_resected_g(self) -> float | None:
        """Refuse impossible weights."""
        return self._within("resected_g", _MOST_G, "g")

    def clean(self) -> dict[str, Any]:
        """Require a description of an operation that is not in the list."""
        cleaned: dict[str, Any] = super().clean() or self.cleaned_data
        if cleaned.get("kind") == Operation.Kind.OTHER and not cleaned.get("words"):
            self.add_error("words", "Describe the operation.")
        return cleaned

    def _within(self, name: str, most: float, unit: str) -> float | None:
        value: float | None = self.cleaned_data[name]
        if value is not None and not 0 < value <= most:
            raise forms.ValidationError(f"Enter a number above 0 and up to {most:g} {unit}, or leave it empty.")
        return value


class OperationRemovalForm(RecordForm):
    """Remove an operation, unless it has changed in the meantime."""

    watched = ("kind", "side", "day", "volume_cc", "resected_g", "words")

    class Meta:
        model = Operation
        fields = ()


class ConsentForm(RecordForm):
    """A patient's consent and its day."""

    class Meta:
        model = Consent
        fields = ("purpose", "given_on", "note")
        labels = {"purpose": "Consent to", "note": "Remark"}  # noqa: RUF012
        help_texts = {"note": "For example, where the signed form is kept."}  # noqa: RUF012
        widgets = {"given_on": _day()}  # noqa: RUF012

    def clean_given_on(self) -> datetime.date:
        """Refuse future days."""
        return _until_today(self.cleaned_data["given_on"])


class WithdrawalForm(RecordForm):
    """Day on which a consent was withdrawn. Empty: it is valid."""

    class Meta:
        model = Consent
        fields = ("given_on", "withdrawn_on", "note")
        labels = {"note": "Remark"}  # noqa: RUF012
        help_texts = {"withdrawn_on": "Leave it empty while the consent is valid."}  # noqa: RUF012
        widgets = {"given_on": _day(), "withdrawn_on": _day()}  # noqa: RUF012

    def clean_given_on(self) -> datetime.date:
        """Refuse future days."""
        return _until_today(self.cleaned_data["given_on"])

    def clean_withdrawn_on(self) -> datetime.date | None:
        """Refuse future days, and those before the consent."""
        day: datetime.date | None = self.cleaned_data["withdrawn_on"]
        given = self.cleaned_data.get("given_on")
        if day is not None and given is not None and day < given:
            raise forms.ValidationError("This is before the consent was given.")
        return None if day is None else _until_today(day)


class _VisitField(forms.ModelChoiceField):  # type: ignore[type-arg]
    """A visit of one patient, by day and time."""

    def label_from_instance(self, obj: Visit) -> str:
        """Day and time."""
        return f"{timezone.localtime(obj.taken_at):%Y-%m-%d, %H:%M}"


class CircumstancesForm(RecordForm):
    """Occasion and posture of a visit, and whether it repeats another."""

    class Meta:
        model = Visit
        fields = ("occasion", "posture", "repeat_of")

    repeat_of = _VisitField(
        label="Repeat of", required=False, queryset=Visit.objects.none(), empty_label="no other visit",
        help_text="Photographed again to see how well two measurements agree.",
    )  # fmt: skip

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        name_empty_choices(self.fields)
        repeat = self.fields["repeat_of"]
        assert isinstance(repeat, forms.ModelChoiceField)
        visit: Visit = self.instance
        earlier = Visit.objects.filter(patient=visit.patient_id, subject_kind=visit.subject_kind)
        repeat.queryset = earlier.filter(taken_at__lte=visit.taken_at).exclude(pk=visit.pk)

    def clean_repeat_of(self) -> Visit | None:
        """Refuse to declare a repeat if there was an operation in between."""
        first: Visit | None = self.cleaned_data["repeat_of"]
        operations = () if first is None else self.instance.patient.operations.all()
        if first is not None and any(is_between(operation, first, self.instance) for operation in operations):
            raise forms.ValidationError("There was an operation between the visits: this is not a repeat.")
        return first


class ConclusionForm(RecordForm):
    """A clinician's conclusion."""

    class Meta:
        model = Conclusion
        fields = ("text",)
        labels = {"text": "Conclusion"}  # noqa: RUF012
        widgets = {"text": forms.Textarea(attrs={"rows": 4})}  # noqa: RUF012

    def clean_text(self) -> str:
        """Refuse control characters, which other systems do not accept."""
        text: str = self.cleaned_data["text"]
        require_dicom_text(text, "UT")
        return text


def _until_today(day: datetime.date) -> datetime.date:
    if not FIRST_DAY <= day <= timezone.localdate():
        raise forms.ValidationError("Enter today or an earlier day, from 1900 on.")
    return day
