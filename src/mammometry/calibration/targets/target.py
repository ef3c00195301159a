"""Calibration targets: what is printed or surveyed, as numbers; no pixels here.

Every target lists its points in its own frame, mm. A detection's ids index that list.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from typing import ClassVar, TypeAlias, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from mammometry.base.errors import SessionError
from mammometry.geometry.arrays import Array, Float64, read_only

_MIN_PER_SIDE = 2
_MAX_PER_SIDE = 2000  # more than any picture could resolve
_MAX_PRINT_SCALE = 0.1
"""Printers miss the scale by a few per cent at most; a larger difference is a slip of the pen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Board(ABC):
    """A flat print that is moved about: its frame is the world's only in the first pose."""

    is_surveyed: ClassVar[bool] = False
    """Whether its frame is the world."""

    edge_std_mm: float | None = None
    """Standard uncertainty of `edge_mm` as it was measured, mm; None: nobody measured the print."""
    flatness_mm: float | None = None
    """Standard deviation of the board's points from a plane, mm, as measured; None: not measured."""

    def __post_init__(self) -> None:
        _require_measured(edge_std_mm=self.edge_std_mm, flatness_mm=self.flatness_mm)

    @property
    @abstractmethod
    def edge_mm(self) -> float:
        """Length of the pattern along x, mm: what is measured on the print."""

    @property
    def scale_std(self) -> float | None:
        """Relative standard uncertainty of all lengths; None where the print was not measured."""
        return None if self.edge_std_mm is None else self.edge_std_mm / self.edge_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class _SquaresBoard(_Board):
    """A board of squares. Frame as OpenCV's: origin at the outer corner of the first one, x right, y down, z into it.

    Ids count the inner corners row by row: ``(columns − 1) × (rows − 1)`` of them.
    """

    squares: tuple[int, int]
    """Columns and rows of SQUARES: one more each than inner corners."""
    square_mm: float
    """Side of a square, mm, as measured on the print."""

    def __post_init__(self) -> None:
        _Board.__post_init__(self)
        _require_grid("squares", self.squares, 3)
        _require_positive(square_mm=self.square_mm)

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Inner corners by id, board frame, mm."""
        column, row = np.meshgrid(np.arange(1, self.squares[0]), np.arange(1, self.squares[1]))
        corners = np.stack([column.ravel(), row.ravel(), np.zeros(column.size)], axis=1)
        return read_only(corners * self.square_mm)

    @property
    def edge_mm(self) -> float:
        """Length of the pattern along x: all columns of squares, mm."""
        return self.squares[0] * self.square_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class CharucoTarget(_SquaresBoard):
    """A ChArUco board: chess corners identified by ArUco markers in the white squares; ids are OpenCV's.

    Raises:
        ValueError: fewer than 3 × 3 squares, or a marker that does not fit into its square.
    """

    kind: ClassVar[str] = "charuco"

    marker_mm: float
    """Side of a marker, mm, as measured on the print."""
    dictionary: str
    """OpenCV's name of the marker dictionary, e.g. ``DICT_5X5_250``."""
    legacy_pattern: bool = False
    """True for boards made before OpenCV 4.6, which start with a white square when the number of rows is even."""

    def __post_init__(self) -> None:
        _SquaresBoard.__post_init__(self)
        if not 0 < self.marker_mm < self.square_mm:
            raise ValueError(f"marker_mm must lie between 0 and square_mm ({self.square_mm}), found {self.marker_mm}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ChessboardTarget(_SquaresBoard):
    """A plain chessboard whose first square is dark.

    A board of equal parity in columns and rows looks the same after half a turn; its first corner is then the one
    nearer to the picture's top.

    Raises:
        ValueError: fewer than 3 × 3 squares, or a size that is not positive.
    """

    kind: ClassVar[str] = "chessboard"


@dataclass(frozen=True, slots=True, kw_only=True)
class CirclesTarget(_Board):
    """A board of dark circles on white.

    Origin at the first circle's centre, x right, y down, z into the board; ids row by row.

    Raises:
        ValueError: fewer than 2 × 2 circles, or circles that would touch.
    """

    kind: ClassVar[str] = "circles"

    grid: tuple[int, int]
    """Circles in a row, and rows."""
    pitch_mm: float
    """Symmetric: distance of neighbours, mm. Asymmetric (as OpenCV's): distance of the rows, half of that in a row."""
    diameter_mm: float
    """Diameter of a circle, mm."""
    asymmetric: bool = False
    """True where every second row is shifted by half a step."""

    def __post_init__(self) -> None:
        _Board.__post_init__(self)
        _require_grid("grid", self.grid, _MIN_PER_SIDE)
        _require_positive(pitch_mm=self.pitch_mm, diameter_mm=self.diameter_mm)
        nearest_mm = self.pitch_mm * (math.sqrt(2.0) if self.asymmetric else 1.0)
        if self.diameter_mm >= nearest_mm:
            raise ValueError(f"circles of diameter_mm {self.diameter_mm} touch at a distance of {nearest_mm:.3f} mm")

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Circle centres by id, board frame, mm."""
        column, row = (grid.ravel().astype(np.float64) for grid in np.meshgrid(*map(np.arange, self.grid)))
        x = 2.0 * column + row % 2 if self.asymmetric else column
        return read_only(np.stack([x, row, np.zeros_like(x)], axis=1) * self.pitch_mm)

    @property
    def edge_mm(self) -> float:
        """Length of the pattern along x: from the first column's centres to the last one's, mm."""
        return float(np.ptp(self.points_target[:, 0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class DottedCylinderTarget:
    """A cylinder covered with rows and columns of square dots, a label printed beyond the last row of each column.

    Frame: z along the axis towards the labelled end, which is up; z = 0 at row 0, the row farthest from the labels;
    column 0 at +x; columns count counterclockwise seen from above, which is to the right in a picture taken upright.
    Ids are ``row · columns + column``.

    Raises:
        ValueError: too few dots, a size that is not positive, or columns that overlap around the cylinder.
    """

    kind: ClassVar[str] = "dotted-cylinder"
    is_surveyed: ClassVar[bool] = True
    """Whether its frame is the world."""

    dots: tuple[int, int]
    """Rows along the axis, and columns around it (all of them, whether seen by one camera or not)."""
    radius_mm: float
    """Radius of the printed surface, mm."""
    row_pitch_mm: float
    """Distance of neighbouring rows along the axis, mm."""
    column_pitch_mm: float
    """Distance of neighbouring columns along the arc, mm."""
    dot_mm: float | None = None
    """Side of a dot, mm; measured in the pictures where not given."""
    scale_std: float | None = None
    """Relative standard uncertainty of all lengths, from the survey; None: not known."""

    def __post_init__(self) -> None:
        _require_grid("dots", self.dots, 3)
        _require_positive(
            radius_mm=self.radius_mm, row_pitch_mm=self.row_pitch_mm, column_pitch_mm=self.column_pitch_mm
        )
        if self.dot_mm is not None and not 0 < self.dot_mm < min(self.row_pitch_mm, self.column_pitch_mm):
            raise ValueError(f"dot_mm must lie between 0 and the smaller pitch, found {self.dot_mm}")
        around_mm = self.dots[1] * self.column_pitch_mm
        girth_mm = 2 * math.pi * self.radius_mm
        if around_mm > girth_mm * (1 + 1e-3):
            raise ValueError(
                f"{self.dots[1]} columns of {self.column_pitch_mm} mm need {around_mm:.1f} mm, "
                f"the girth is {girth_mm:.1f} mm"
            )
        _require_measured(scale_std=self.scale_std)

    @property
    def closes(self) -> bool:
        """True where the columns go all the way round, so that the last is the first one's neighbour."""
        girth_mm = 2 * math.pi * self.radius_mm
        return abs(self.dots[1] * self.column_pitch_mm - girth_mm) < 1e-2 * self.column_pitch_mm

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Dot centres by id, cylinder frame, mm."""
        rows, columns = self.dots
        row, column = (grid.ravel() for grid in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
        return read_only(self.on_surface(column * self.column_pitch_mm, row * self.row_pitch_mm))

    def on_surface(self, arc_mm: Float64[Array, "*n"], height_mm: Float64[Array, "*n"]) -> Float64[Array, "*n 3"]:
        """Points of the printed surface at unrolled coordinates (along the arc, along the axis), cylinder frame, mm."""
        angle_rad = arc_mm / self.radius_mm
        return np.stack(
            [self.radius_mm * np.cos(angle_rad), self.radius_mm * np.sin(angle_rad), np.asarray(height_mm, np.float64)],
            axis=-1,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PointsTarget:
    """A rigid object with surveyed points in its own frame, which is the world; ids are positions in the list.

    Raises:
        ValueError: fewer than four points, or a coordinate that is not finite.
    """

    kind: ClassVar[str] = "points"
    is_surveyed: ClassVar[bool] = True
    """Whether its frame is the world."""

    points_mm: tuple[tuple[float, float, float], ...]
    """Surveyed coordinates, mm."""
    dot_diameter_mm: float | None = None
    """Diameter of the round dots that mark the points, mm, where they are such."""
    scale_std: float | None = None
    """Relative standard uncertainty of all lengths, from the survey; None: not known."""

    def __post_init__(self) -> None:
        if len(self.points_mm) < 4:
            raise ValueError(f"points_mm needs at least 4 points, found {len(self.points_mm)}")
        if not np.isfinite(np.asarray(self.points_mm)).all():
            raise ValueError("points_mm has a coordinate that is not a finite number")
        if self.dot_diameter_mm is not None:
            _require_positive(dot_diameter_mm=self.dot_diameter_mm)
        _require_measured(scale_std=self.scale_std)

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Surveyed points by id, mm."""
        return read_only(np.array(self.points_mm, dtype=np.float64))


Target: TypeAlias = CharucoTarget | ChessboardTarget | CirclesTarget | DottedCylinderTarget | PointsTarget
"""Any of the five."""

_KINDS: Mapping[str, type[Target]] = {
    cls.kind: cls for cls in (CharucoTarget, ChessboardTarget, CirclesTarget, DottedCylinderTarget, PointsTarget)
}


def target_from_table(table: Mapping[str, object]) -> Target:
    """Read the manifest's ``[target]`` table strictly.

    ``edge_mm``, the pattern's length along x as it was measured on the print, scales all of a board's sizes: the value
    that is returned holds the true ones.

    Raises:
        SessionError: an unknown kind or key, a missing key, a value of the wrong type or outside its range.
    """
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise SessionError(
            "[target] kind",
            found="nothing" if kind is None else repr(kind),
            expected=f"one of {', '.join(map(repr, _KINDS))}",
            remedy="Name the calibration target in session.toml",
        )
    cls = _KINDS[kind]
    values = {key: _as_tuples(value) for key, value in table.items() if key != "kind"}
    names = [field.name for field in fields(cls)]
    is_board = issubclass(cls, _Board)
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
            raise _table_error(name, repr(value), error.errors()[0]["msg"]) from None
    for field in fields(cls):
        if field.default is MISSING and field.name not in values:
            raise _table_error(field.name, "nothing", f"a value: every {kind} target has one")
    try:
        target = cls(**values)  # type: ignore[arg-type]  # just validated
    except ValueError as error:
        raise _table_error(kind, "a table that makes no target", str(error)) from None
    return target if edge_mm is None else _as_measured(target, edge_mm)


def _as_measured(target: Target, edge_mm: object) -> Target:
    """All sizes of a board scaled so that its edge is as long as was measured."""
    assert isinstance(target, _Board)
    if isinstance(edge_mm, bool) or not isinstance(edge_mm, int | float):
        raise _table_error("edge_mm", repr(edge_mm), "a number of millimetres")
    if target.edge_std_mm is None:
        raise _table_error("edge_std_mm", "nothing", "the standard uncertainty of the edge_mm that was measured")
    if not abs(edge_mm / target.edge_mm - 1.0) < _MAX_PRINT_SCALE:
        raise _table_error(
            "edge_mm",
            f"{edge_mm:g} mm",
            f"within {_MAX_PRINT_SCALE:.0%} of the {target.edge_mm:g} mm that the other sizes give along x",
        )
    scale = edge_mm / target.edge_mm
    sizes = [name for name in ("square_mm", "marker_mm", "pitch_mm", "diameter_mm") if hasattr(target, name)]
    return replace(target, **{name: getattr(target, name) * scale for name in sizes})


def _table_error(name: str, found: str, expected: str) -> SessionError:
    return SessionError(f"[target] {name}", found=found, expected=expected, remedy="Correct it in session.toml")


def _as_tuples(value: object) -> object:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value


def _require_grid(name: str, grid: tuple[int, int], least: int) -> None:
    if min(grid) < least or max(grid) > _MAX_PER_SIDE:
        raise ValueError(
            f"{name} must be at least {least} × {least} and at most {_MAX_PER_SIDE} × {_MAX_PER_SIDE}, "
            f"found {grid[0]} × {grid[1]}"
        )


def _require_positive(**sizes_mm: float) -> None:
    for name, size_mm in sizes_mm.items():
        if not (size_mm > 0 and math.isfinite(size_mm)):
            raise ValueError(f"{name} must be a positive number of millimetres, found {size_mm}")


def _require_measured(**measured: float | None) -> None:
    for name, value in measured.items():
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise ValueError(f"{name} must be a positive number, found {value}: leave it out if it was not measured")
