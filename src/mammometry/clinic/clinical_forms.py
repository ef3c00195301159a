"""Forms of what a clinic knows beside its photographs: operations, consents, conclusions."""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING, Any

from django import forms
from django.utils import timezone

from mammometry.clinic.forms import name_empty_choices, require_dicom_text
from mammometry.clinic.models import Conclusion, Consent, Operation, Visit

if TYPE_CHECKING:
    _OperationForm = forms.ModelForm[Operation]
    _ConsentForm = forms.ModelForm[Consent]
    _ConclusionForm = forms.ModelForm[Conclusion]
    _CircumstancesForm = forms.ModelForm[Visit]
else:  # none can be subscripted while the program runs
    _OperationForm = _ConsentForm = _ConclusionForm = _CircumstancesForm = forms.ModelForm

_MOST_CC = 5000.0  # the largest expanders hold 1,500 cc
_MOST_G = 10_000.0  # gigantomastia: some kg a side


def _day() -> forms.DateInput:
    return forms.DateInput(attrs={"type": "date"}, format="%Y-%m-%d")


def _number(most: float) -> forms.NumberInput:
    return forms.NumberInput(attrs={"min": "0", "max": f"{most:g}", "step": "any", "inputmode": "decimal"})


class OperationForm(_OperationForm):
    """What was done to a breast, and when."""

    class Meta:
        model = Operation
        fields = ("kind", "side", "day", "volume_cc", "resected_g", "words")
        labels = {  # noqa: RUF012
            "kind": "Operation",
            "volume_cc": "Volume, cc",
            "resected_g": "Tissue taken out, g",
            "words": "In words",
        }
        help_texts = {  # noqa: RUF012
            "volume_cc": "Of the implant, of the expander’s whole filling, or of the injected fat; each side.",
            "resected_g": "Weight, each side.",
            "words": "The flap, the implant’s type, or what was done otherwise.",
        }
        widgets = {"day": _day(), "volume_cc": _number(_MOST_CC), "resected_g": _number(_MOST_G)}  # noqa: RUF012

    def clean_day(self) -> datetime.date:
        """Refuse days that have not come yet, and those before the patient was born."""
        day: datetime.date = self.cleaned_data["day"]
        born = self.instance.patient.born
        if day > timezone.localdate() or (born is not None and day < born):
            raise forms.ValidationError("Enter a day between the patient’s birth and today.")
        return day

    def clean_words(self) -> str:
        """Refuse control characters, which no other system takes."""
        words: str = self.cleaned_data["words"]
        require_dicom_text(words, "UT")
        return words

    def clean_volume_cc(self) -> float | None:
        """Refuse volumes that no breast holds."""
        return self._within("volume_cc", _MOST_CC, "cc")

    def clean_resected_g(self) -> float | None:
        """Refuse weights that no breast has."""
        return self._within("resected_g", _MOST_G, "g")

    def clean(self) -> dict[str, Any]:
        """Ask what was done where the list does not say."""
        cleaned: dict[str, Any] = super().clean() or self.cleaned_data
        if cleaned.get("kind") == Operation.Kind.OTHER and not cleaned.get("words"):
            self.add_error("words", "Say what was done.")
        return cleaned

    def _within(self, name: str, most: float, unit: str) -> float | None:
        value: float | None = self.cleaned_data[name]
        if value is not None and not 0 < value <= most:
            raise forms.ValidationError(f"Enter a number above 0 and up to {most:g} {unit}, or nothing.")
        return value


class ConsentForm(_ConsentForm):
    """What a patient agreed to, and since when."""

    class Meta:
        model = Consent
        fields = ("purpose", "given_on", "note")
        labels = {"purpose": "Consent to", "note": "Remark"}  # noqa: RUF012
        help_texts = {"note": "Where the signed form lies, for example."}  # noqa: RUF012
        widgets = {"given_on": _day()}  # noqa: RUF012

    def clean_given_on(self) -> datetime.date:
        """Refuse days that have not come yet."""
        return _until_today(self.cleaned_data["given_on"])


class WithdrawalForm(_ConsentForm):
    """Since when a consent holds no more. Empty: it holds."""

    class Meta:
        model = Consent
        fields = ("given_on", "withdrawn_on", "note")
        labels = {"note": "Remark"}  # noqa: RUF012
        help_texts = {"withdrawn_on": "Leave it empty while the consent holds."}  # noqa: RUF012
        widgets = {"given_on": _day(), "withdrawn_on": _day()}  # noqa: RUF012

    def clean_given_on(self) -> datetime.date:
        """Refuse days that have not come yet."""
        return _until_today(self.cleaned_data["given_on"])

    def clean_withdrawn_on(self) -> datetime.date | None:
        """Refuse days before the consent, and those that have not come yet."""
        day: datetime.date | None = self.cleaned_data["withdrawn_on"]
        given = self.cleaned_data.get("given_on")
        if day is not None and given is not None and day < given:
            raise forms.ValidationError("This is before the consent was given.")
        return None if day is None else _until_today(day)


class CircumstancesForm(_CircumstancesForm):
    """Why the patient came, and how she held herself."""

    class Meta:
        model = Visit
        fields = ("occasion", "posture")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        name_empty_choices(self.fields)


class ConclusionForm(_ConclusionForm):
    """What a clinician concludes."""

    class Meta:
        model = Conclusion
        fields = ("text",)
        labels = {"text": "Conclusion"}  # noqa: RUF012
        widgets = {"text": forms.Textarea(attrs={"rows": 4})}  # noqa: RUF012

    def clean_text(self) -> str:
        """Refuse control characters, which no other system takes."""
        text: str = self.cleaned_data["text"]
        require_dicom_text(text, "UT")
        return text


def _until_today(day: datetime.date) -> datetime.date:
    if day > timezone.localdate():
        raise forms.ValidationError("Enter today or an earlier day.")
    return day
