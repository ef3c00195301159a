"""Forms of visits with photographs taken with one telephone and a printed board."""

from typing import Any

from django import forms

from mammometry.base.errors import SessionError
from mammometry.calibration.targets.table import target_from_table
from mammometry.clinic.forms import DAY_AND_TIME, ask_about_day, name_empty_choices
from mammometry.clinic.intake.walks import board_table, volume_share_of_print
from mammometry.clinic.models import Visit, Walk
from mammometry.clinic.record_form import RecordForm
from mammometry.walk.print_size import PRINT_STD
from mammometry.walk.region import TELEPHONE_BOARD

PRINTED_MM = TELEPHONE_BOARD["squares"][0] * TELEPHONE_BOARD["square_mm"]
"""Length of the board's columns, printed at 100 %."""
_MOST_STD_MM = PRINT_STD * PRINTED_MM  # a larger uncertainty is no better than no measurement


def print_words() -> dict[str, str]:
    """Assumed length of a print that is not measured, and its share of a volume's interval, as text."""
    return {
        "print_mm": f"{PRINTED_MM:.0f} ± {PRINT_STD * PRINTED_MM:.1f} mm",
        "print_share": f"± {100 * volume_share_of_print():.0f} %",
    }


def _edge() -> forms.FloatField:
    return forms.FloatField(
        label="Length of the printed board, mm", required=False,
        help_text=f"All eleven squares of a row, not the small ruler: {PRINTED_MM:.0f} mm if it was printed at 100 %.",
        widget=forms.NumberInput(attrs={"step": "any", "inputmode": "decimal"}),
    )  # fmt: skip


def _edge_std() -> forms.FloatField:
    return forms.FloatField(
        label="Its uncertainty, mm", required=False, min_value=0.01, max_value=_MOST_STD_MM,
        help_text="Standard deviation: 0.2 with a steel ruler.",
        widget=forms.NumberInput(attrs={"step": "any", "inputmode": "decimal"}),
    )  # fmt: skip


class _Board(RecordForm):
    """Length of the print and its uncertainty: both or neither."""

    edge_mm = _edge()
    edge_std_mm = _edge_std()

    def clean(self) -> dict[str, Any]:
        """Refuse one without the other, and an implausible length."""
        values: dict[str, Any] = super().clean() or self.cleaned_data
        edge_mm, edge_std_mm = values.get("edge_mm"), values.get("edge_std_mm")
        if edge_mm is not None and edge_std_mm is None and "edge_std_mm" not in self.errors:
            self.add_error("edge_std_mm", "Enter the uncertainty of the length, such as 0.2.")
        elif edge_mm is None and edge_std_mm is not None and "edge_mm" not in self.errors:
            self.add_error("edge_mm", "Enter the measured length, or remove its uncertainty.")
        elif edge_mm is not None and edge_std_mm is not None:
            try:
                target_from_table(board_table(edge_mm, edge_std_mm))
            except SessionError:
                self.add_error(
                    "edge_mm",
                    f"Found {edge_mm:g} mm. Measure all eleven squares of a row: their length is within 10 % of "
                    f"{PRINTED_MM:.0f} mm.",
                )
        return values


class BoardForm(_Board):
    """Measured length of a visit's board."""

    class Meta:
        model = Walk
        fields = ("edge_mm", "edge_std_mm")


class WalkForm(_Board):
    """Patient, day and posture of a visit with a telephone, and the board."""

    class Meta:
        model = Visit
        fields = ("patient", "taken_at", "occasion", "posture", "note")
        labels = {"taken_at": "Day and time"}  # noqa: RUF012
        widgets = {  # noqa: RUF012
            "patient": forms.HiddenInput(),
            "taken_at": DAY_AND_TIME,
            "note": forms.Textarea(attrs={"rows": 2}),
        }

    field_order = ("patient", "taken_at", "occasion", "posture", "edge_mm", "edge_std_mm", "note")
    questions: tuple[str, ...] = ()

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        name_empty_choices(self.fields)
        self.fields["posture"].initial = Visit.Posture.STANDING

    def clean(self) -> dict[str, Any]:
        """Ask whether a day in the future is right."""
        values = super().clean()
        ask_about_day(self, None)
        return values
