"""Read session.toml's ``[target]`` into a target of a registered kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from mammometry.base.errors import SessionError
from mammometry.base.sizes import Size, fitting
from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.target import TARGETS, Target

_MAX_PRINT_SCALE = 0.08
"""Largest relative scale error of a print. Printers err by a few per cent, and fitting A4 to Letter shrinks it by 6 %.
A larger difference is a typing error, or the length of ten of eleven columns (9 %)."""
_TARGET_MM, _USUAL_TARGET_MM = (20.0, 2500.0), (60.0, 1500.0)
"""Possible and usual longest side of a target's points, mm. A cast of 40 mm is no smaller than its target."""


def target_from_table(table: Mapping[str, object]) -> Target:
    """Read the manifest's ``[target]`` table strictly.

    ``edge_mm`` is the pattern's length along x, measured on the print. It scales all sizes of a board: the returned
    target has the true ones.

    Raises:
        SessionError: an unknown kind or key, a missing key, a value of the wrong type or outside its range.
    """
    cls = TARGETS.find(
        table.get("kind"), "[target] kind", error=SessionError, remedy="Name a kind of target in session.toml"
    )
    kind = TARGETS.name_of(cls)
    values = {key: _as_tuples(value) for key, value in table.items() if key != "kind"}
    names = [field.name for field in fields(cls)]  # type: ignore[arg-type]  # every kind is a dataclass
    is_board = issubclass(cls, Board)
    edge_mm = values.pop("edge_mm", None) if is_board else None
    keys = [*names, "edge_mm"] if is_board else names
    for key in values:
        if key not in names:
            raise SessionError(
                f"[target] {key}",
                found="an unknown key",
                expected=f"for kind {kind!r} only {', '.join(keys)}",
                remedy="Correct or remove it in session.toml",
            )
    types = get_type_hints(cls)
    for name, value in values.items():
        try:
            values[name] = TypeAdapter(types[name]).validate_python(value, strict=True)
        except ValidationError as error:
            raise _table_error(name, repr(value), error.errors()[0]["msg"].removeprefix("Input should be ")) from None
    for field in fields(cls):  # type: ignore[arg-type]
        if field.default is MISSING and field.name not in values:
            raise _table_error(field.name, "nothing", f"a value, which every {kind} target needs")
    try:
        target = cls(**values)
    except ValueError as error:
        raise _table_error(kind, "an invalid target", str(error)) from None
    _require_size(target)
    return _as_measured(target, edge_mm) if isinstance(target, Board) and edge_mm is not None else target


def _require_size(target: Target) -> None:
    """Refuse impossible sizes. `judge.scale` finds smaller errors by means of the cameras."""
    span = Size(
        mm=float(np.ptp(target.points_target, axis=0).max()),
        name="span",
        possible_mm=_TARGET_MM,
        usual_mm=_USUAL_TARGET_MM,
        words="its points span {}",
    )
    if span.is_possible:
        return
    name, stated_mm = target.stated_size
    raise SessionError(
        f"[target] {name}",
        found=f"{stated_mm:g} mm, with which {span}",
        expected=span.expected,
        remedy=f"Enter millimetres in session.toml{fitting(stated_mm, [span])}",
    )


def _as_measured(board: Board, edge_mm: object) -> Board:
    """Scale all sizes of a board to the measured edge."""
    if isinstance(edge_mm, bool) or not isinstance(edge_mm, int | float):
        raise _table_error("edge_mm", repr(edge_mm), "a number of millimetres")
    if board.edge_std_mm is None:
        raise _table_error("edge_std_mm", "nothing", "the standard uncertainty of the measured edge_mm")
    if not abs(edge_mm / board.edge_mm - 1.0) < _MAX_PRINT_SCALE:
        raise _table_error(
            "edge_mm",
            f"{edge_mm:g} mm",
            f"within {_MAX_PRINT_SCALE:.0%} of the {board.edge_mm:g} mm that follow from the other sizes along x",
        )
    return board.scaled(edge_mm / board.edge_mm)


def _table_error(name: str, found: str, expected: str) -> SessionError:
    return SessionError(f"[target] {name}", found=found, expected=expected, remedy="Correct it in session.toml")


def _as_tuples(value: object) -> object:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value
