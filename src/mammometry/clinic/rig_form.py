"""Form that describes a rig: its pairs of cameras, its board, and the measured size of the print.

It stores the tables of a session.toml, from the form or a file. `capture.sessions.manifest_text` writes them for every
session of the rig.
"""

import copy
import tomllib
from collections.abc import Mapping
from typing import Any

from django import forms

from mammometry.base.errors import MammometryError, SessionError
from mammometry.calibration.targets.board import SquaresBoard
from mammometry.calibration.targets.table import target_from_table
from mammometry.calibration.targets.target import Target
from mammometry.capture.sessions import manifest_text
from mammometry.clinic.models import Rig
from mammometry.clinic.record_form import RecordForm

_FILE_BYTES = 100_000  # a session.toml has a few kB
_TABLES = ("rig", "target", "intrinsics")
PAIRS = 8
"""Largest number of rows for pairs in the form. A file may have more."""
_MOST_SQUARES = 60  # largest number of squares in a row: 2 mm squares on the width of an A4 page
_SQUARES = {"charuco": "ChArUco: squares with markers", "chessboard": "Chessboard: plain squares"}
_AS_IT_IS = "as-it-is"
_DICTIONARIES = tuple(
    f"DICT_{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)
)  # OpenCV's names of its own dictionaries
_MOUNTINGS = {"upright": "upright", "upside-down": "upside down", "left": "turned to the left", "right": "to the right"}
_PRINT_APART = 0.02
"""Relative difference between print and design above which the form asks for confirmation. Printers err by up to 0.5 %.
Counting one square of 14 too many gives 7 %."""
_DECIMALS = 4  # stored decimals of the edge, mm


def _number(step: str = "any", **most: str) -> forms.NumberInput:
    return forms.NumberInput(attrs={"min": "0", "step": step, "inputmode": "decimal", **most})


class RigForm(RecordForm):
    """A rig, described in the form or by a session.toml."""

    mounting = forms.ChoiceField(label="The cameras’ tops point, seen from behind", required=False)
    board = forms.ChoiceField(label="Board", required=False)
    columns = forms.IntegerField(
        label="Squares in a row", required=False, min_value=3, max_value=_MOST_SQUARES, widget=_number("1")
    )
    rows = forms.IntegerField(label="Rows", required=False, min_value=3, max_value=_MOST_SQUARES, widget=_number("1"))
    square_mm = forms.FloatField(
        label="Side of a square as designed, mm", required=False, min_value=0.1, max_value=1000.0, widget=_number()
    )
    marker_mm = forms.FloatField(
        label="Side of a marker as designed, mm", required=False, min_value=0.1, max_value=1000.0, widget=_number()
    )
    dictionary = forms.ChoiceField(label="Markers", required=False, choices=[(name, name) for name in _DICTIONARIES])
    measured_squares = forms.IntegerField(
        label="Measured over this many squares of a row",
        required=False,
        min_value=1,
        max_value=_MOST_SQUARES,
        widget=_number("1"),
        help_text="As many as the ruler or calliper reaches: more squares are more accurate.",
    )
    measured_mm = forms.FloatField(
        label="Their length on the print, mm", required=False, min_value=0.1, max_value=5000.0, widget=_number()
    )
    measured_std_mm = forms.FloatField(
        label="Uncertainty of that length, mm",
        required=False,
        min_value=0.001,
        max_value=10.0,
        widget=_number(),
        help_text="Standard uncertainty: 0.1 to 0.3 mm with a steel ruler, 0.02 to 0.05 mm with a calliper.",
    )
    described_by = forms.FileField(
        label="Or a session.toml of this rig",
        required=False,
        help_text="Its cameras, pairs and board replace the entries here. Its photographs are not needed.",
    )

    class Meta:
        model = Rig
        fields = ("name", "note", "active")
        labels = {"active": "In use"}  # noqa: RUF012
        widgets = {"note": forms.Textarea(attrs={"rows": 2})}  # noqa: RUF012

    def __init__(self, data: Any = None, files: Any = None, *args: Any, **kwargs: Any) -> None:
        rig: Rig | None = kwargs.get("instance")
        if data is not None and rig is not None:  # locked as by `RecordForm`, so that it cannot change in between
            kwargs["instance"] = rig = Rig.objects.select_for_update().get(pk=rig.pk)
        self._before: dict[str, Any] = {} if rig is None else copy.deepcopy(rig.definition)
        described = _described(self._before)
        mountings = dict(_MOUNTINGS)
        if described["mounting"] == _AS_IT_IS:
            mountings |= {_AS_IT_IS: "each camera as in the file"}
        boards = dict(_SQUARES)
        if described["board"] == _AS_IT_IS:
            boards |= {_AS_IT_IS: "as in the file"}
        kwargs["initial"] = {**described, **kwargs.get("initial", {})}
        super().__init__(data, files, *args, **kwargs)
        for name, choices in (("mounting", mountings), ("board", boards)):
            field = self.fields[name]
            assert isinstance(field, forms.ChoiceField)
            field.choices = list(choices.items())
        self.questions: tuple[str, ...] = ()
        self._definition = self._before

    @property
    def _versioned(self) -> list[str]:
        return [*super()._versioned, *_DESCRIPTION]

    @property
    def pair_rows(self) -> list[tuple[Any, Any, Any]]:
        """Fields of each pair: its name and its cameras."""
        return [(self[f"pair{k}_name"], self[f"pair{k}_left"], self[f"pair{k}_right"]) for k in range(PAIRS)]

    @property
    def shown_rows(self) -> int:
        """Number of rows shown at first: the filled ones and one more, at least four."""
        filled = [k for k, row in enumerate(self.pair_rows) if any(field.value() for field in row)]
        return min(PAIRS, max([4, *(k + 2 for k in filled)]))

    @property
    def is_described_otherwise(self) -> bool:
        """Whether cameras or board have changed."""
        return self._definition != self._before

    def clean_described_by(self) -> dict[str, Any] | None:
        """Tables of the file. None if there is no file."""
        file = self.cleaned_data["described_by"]
        if file is None:
            return None
        if file.size > _FILE_BYTES:
            raise forms.ValidationError("This file is too large for a session.toml.")
        try:
            table = tomllib.loads(file.read().decode("utf-8"))
        except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError):
            raise forms.ValidationError("This is not a session.toml: it cannot be read as TOML.") from None
        kept = {name: table[name] for name in _TABLES if name in table}
        if "rig" not in kept:
            raise forms.ValidationError("This file has no table [rig], so it describes no rig.")
        try:
            _require_rig(kept)
        except MammometryError as error:
            raise forms.ValidationError(str(error)) from None
        return kept

    def clean(self) -> dict[str, Any]:
        """Make the description from the file or from the form's fields."""
        values: dict[str, Any] = super().clean() or self.cleaned_data
        if self.errors:
            return values
        if values["described_by"] is not None:
            self._definition = values["described_by"]
            return values
        pairs = self._pairs(values)
        if not pairs:
            self.add_error(None, "A new rig needs its description: enter its pairs of cameras, or choose a file.")
            return values
        definition = copy.deepcopy(self._before)
        definition["rig"] = {**definition.get("rig", {}), "name": values["name"], "pairs": pairs}
        if self._before and "name" in self._before.get("rig", {}):
            definition["rig"]["name"] = self._before["rig"]["name"]
        if values["mounting"] != _AS_IT_IS:
            definition["rig"]["mounting"] = values["mounting"] or "upright"
        if values["board"] != _AS_IT_IS:
            self._set_board(definition, values)
        if not self.errors:
            try:
                _require_rig(definition)
            except MammometryError as error:
                self.add_error(None, _plain(str(error)))
        self._definition = definition
        return values

    def save(self, commit: bool = True) -> Rig:
        """Save the description with the rig."""
        self.instance.definition = self._definition
        rig: Rig = super().save(commit)
        return rig

    def _pairs(self, values: Mapping[str, Any]) -> list[dict[str, str]]:
        pairs = []
        for k in range(PAIRS):
            entered = {part: "_".join(values[f"pair{k}_{part}"].split()) for part in ("name", "left", "right")}
            if not any(entered.values()):
                continue
            for part, text in entered.items():
                if not text:
                    self.add_error(f"pair{k}_{part}", "Enter the pair’s name and both of its cameras.")
            pairs.append(entered)
        return pairs

    def _set_board(self, definition: dict[str, Any], values: Mapping[str, Any]) -> None:
        needed = ["columns", "rows", "square_mm", *(["marker_mm"] if values["board"] == "charuco" else [])]
        for name in needed:
            if values[name] is None:
                self.add_error(name, "Enter this value of the board.")
        if self.errors:
            return
        kept = definition.get("target", {}) if definition.get("target", {}).get("kind") == values["board"] else {}
        table = {name: value for name, value in kept.items() if name not in ("edge_mm", "edge_std_mm")}
        table |= _board_table(values)
        definition["target"] = table
        try:
            board = target_from_table(table)
            board.sheet()
        except MammometryError as error:
            self.add_error("board", _plain(str(error)))
            return
        table |= self._print(values, board)

    def _print(self, values: Mapping[str, Any], board: Target) -> dict[str, float]:
        """The board's edge, from the measured length."""
        names = ("measured_squares", "measured_mm", "measured_std_mm")
        squares, length_mm, std_mm = (values[name] for name in names)
        if squares is None and length_mm is None and std_mm is None:
            return {}
        for name in names:
            if values[name] is None:
                self.add_error(name, "Enter the number of measured squares, their length, and its uncertainty.")
        if self.errors:
            return {}
        assert isinstance(board, SquaresBoard)
        columns = board.squares[0]
        if squares > columns:
            self.add_error("measured_squares", f"A row has {columns} squares. Enter no more than that.")
            return {}
        apart = length_mm / squares / board.square_mm - 1.0
        if abs(apart) > _PRINT_APART and "anyway" not in self.data:
            word = "larger" if apart > 0 else "smaller"
            self.questions = (
                f"By this a square is {length_mm / squares:.2f} mm, {abs(apart):.1%} {word} than designed. Count the "
                "squares again. Is it right?",
            )
            for question in self.questions:
                self.add_error("measured_mm", question)
        return {
            "edge_mm": round(length_mm / squares * columns, _DECIMALS),
            "edge_std_mm": round(std_mm / squares * columns, _DECIMALS),
        }


def _pair_fields() -> dict[str, forms.Field]:
    words = {"name": "Name of pair", "left": "Left camera of pair", "right": "Right camera of pair"}
    return {
        f"pair{k}_{part}": forms.CharField(
            label=f"{text} {k + 1}",
            required=False,
            max_length=60,
            widget=forms.TextInput(attrs={"aria-label": f"{text} {k + 1}", "autocomplete": "off", "size": 14}),
        )
        for k in range(PAIRS)
        for part, text in words.items()
    }


RigForm.base_fields.update(_pair_fields())
_OTHERS = ("name", "note", "active", "described_by", "record_version")
_DESCRIPTION = tuple(name for name in RigForm.base_fields if name not in _OTHERS)
"""Fields that are part of the description."""


def _described(definition: Mapping[str, Any]) -> dict[str, Any]:
    """Initial values of the form, from a description or for a default board."""
    rig, target = definition.get("rig", {}), definition.get("target", {})
    mounting = rig.get("mounting", "upright")
    shown: dict[str, Any] = {
        "mounting": mounting if isinstance(mounting, str) else _AS_IT_IS,
        "board": "charuco" if not definition else _AS_IT_IS,
        "columns": 14,
        "rows": 10,
        "square_mm": 25.0,
        "marker_mm": 18.0,
        "dictionary": "DICT_5X5_250",
    }
    pairs = rig.get("pairs", [])
    for k, pair in enumerate(pairs[:PAIRS]):
        shown |= {f"pair{k}_{part}": pair.get(part, "") for part in ("name", "left", "right")}
    if target.get("kind") in _SQUARES and target.get("dictionary", "DICT_5X5_250") in _DICTIONARIES:
        shown |= {"board": target["kind"], "columns": target["squares"][0], "rows": target["squares"][1]}
        shown |= {name: target[name] for name in ("square_mm", "marker_mm", "dictionary") if name in target}
        if "edge_mm" in target:
            shown |= {"measured_squares": target["squares"][0], "measured_mm": target["edge_mm"]}
            shown["measured_std_mm"] = target.get("edge_std_mm")
    return shown


def _board_table(values: Mapping[str, Any]) -> dict[str, Any]:
    table: dict[str, Any] = {
        "kind": values["board"],
        "squares": [values["columns"], values["rows"]],
        "square_mm": values["square_mm"],
    }
    if values["board"] == "charuco":
        table |= {"marker_mm": values["marker_mm"], "dictionary": values["dictionary"] or "DICT_5X5_250"}
    return table


def _require_rig(definition: Mapping[str, Any]) -> None:
    """Check the description in the same way as a session does.

    Raises:
        SessionError: the description is invalid.
    """
    manifest_text(definition, "torso")
    if "target" in definition:
        target_from_table(definition["target"])


def _plain(sentence: str) -> str:
    """Remove the name of session.toml from a sentence, because the user filled in a form instead."""
    return sentence.replace("session.toml: ", "").replace(" in session.toml", "").replace("[target] ", "")


def is_measured(definition: Mapping[str, Any]) -> bool:
    """Whether the size of the print is known, or the target is not printed."""
    target = definition.get("target", {})
    return target.get("kind") not in _SQUARES or "edge_mm" in target


def board_of(typed: Mapping[str, str]) -> Target:
    """The board that is being entered in the form.

    Args:
        typed: values of `board`, `columns`, `rows`, `square_mm`, `marker_mm`, `dictionary`.

    Raises:
        SessionError: the values do not describe a board yet.
    """
    form = RigForm({**typed, "name": "board"})
    values = {name: form.fields[name] for name in ("board", "columns", "rows", "square_mm", "marker_mm", "dictionary")}
    try:
        table = _board_table({name: field.clean(typed.get(name, "")) for name, field in values.items()})
    except forms.ValidationError as error:
        raise _no_board(" ".join(error.messages)) from None
    if None in (*table["squares"], table["square_mm"], table.get("marker_mm", 0)):
        raise _no_board("nothing for some of its sizes")
    return target_from_table(table)


def _no_board(found: str) -> SessionError:
    return SessionError("the board", found=found, expected="columns, rows and sizes", remedy="Enter them")


def board_svg(target: Target) -> str:
    """A printed target with its white border, as SVG in millimetres.

    Raises:
        SessionError: there is no marker dictionary of the target's name.
    """
    sheet = target.sheet()
    (left, top), (right, bottom) = sheet.extent_mm
    border = 0.04 * (right - left)
    view = f"{left - border:g} {top - border:g} {right - left + 2 * border:g} {bottom - top + 2 * border:g}"
    path = "".join(f"M{x:g} {y:g}h{w:g}v{h:g}h{-w:g}z" for x, y, w, h in sheet.rectangles)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{view}"><title>{target.caption()}</title>'
        f'<rect x="{left - border:g}" y="{top - border:g}" width="{right - left + 2 * border:g}" '
        f'height="{bottom - top + 2 * border:g}" fill="#fff"/><path d="{path}" fill="#000"/></svg>'
    )
