"""Measure the size of the printed board with a bank card that lies on it.

The card's upper side is a known rectangle in a plane parallel to the board, and each photograph's camera is known in
the board's frame. Points on the card's edges are measured in each photograph, and one rectangle is fitted to all of
them. An edge is measured only where the camera does not see the card's side wall below it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby, islice

import numpy as np
from scipy.ndimage import map_coordinates

from mammometry.base.normal import MAD
from mammometry.base.photograph import Photograph
from mammometry.base.value import value
from mammometry.calibration.features.pixels import linear_luma
from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.card_field import (
    CARD_MM,
    CARD_THICKNESS_MM,
    CARD_TOLERANCE_MM,
    FIELD_EDGE_MM,
    FIELD_MIDDLE,
    field_sheet,
)
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.geometry import Array, Bool, Camera, Float64
from mammometry.walk.region import TELEPHONE_BOARD

_STEP_MM = 0.2  # pixel size of the rectified pictures: half a telephone's pixel on the board
_MARGIN_MM = 10.0  # margin of the rectified pictures around the card's field
_ASIDE_MM, _TURNED_RAD = 6.0, 0.07  # largest shift and rotation of a card relative to its field
_REACH_MM = 2.0  # half-length of a profile across an edge
_PROFILE_MM = 0.1  # distance between the samples of a profile
_ROUND_MM = 6.0  # excluded at each end of an edge: corners are rounded by 3.18 mm (ISO/IEC 7810)
_ALONG_MM, _BLURRED = 0.5, 1  # distance between profiles; number excluded on either side of a change in the print
_CHUNK_MM = 5.0  # length of edge whose mean profile gives one point
_PLATEAU_MM = (0.7, 1.6)  # distances from the edge between which the brightness of card and paper is measured
_LEAST_STEP = 0.3
"""Smallest step of brightness at an edge, relative to white paper. Shadows displace weaker edges by 0.4 mm."""
_MOST_OFF_MM = 1.2  # largest distance of an edge from its position in the previous round: 1.4 % of the card's width
_PRINT_SEEN = 0.5  # correlation of a picture with the print above which there is no card on it
_WALL, _OBLIQUE = 0.03, 0.8  # largest tangent of the viewing angle: from outside, where the side wall shows; inside
_LIFT_STD_MM = 0.1  # std of the card's height above the print: tape, thickness of 0.68 to 0.84 mm (ISO/IEC 7810)
_EDGE_STD_MM = 0.05  # systematic std of the distance between two edges; 0.02 on rendered cards, with a known tone curve
_FEWEST = 5  # fewest photographs, and fewest points on an edge
_HUBER = 1.5  # residual beyond which the loss is linear, standard deviations


@value
class CardScale:
    """Size of the printed board, measured with a bank card."""

    width_mm: float
    height_mm: float
    """Sides of the card, if the board has its stated size."""
    scale: float
    """True length on the board relative to its stated length."""
    std: float
    """Its standard uncertainty, from the measurement and the tolerances of cards."""
    photographs: int
    """Photographs that show the card's edges."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rectangle:
    """A card's upper side in its plane, mm."""

    middle: Float64[Array, 2]
    turn_rad: float
    size_mm: Float64[Array, 2]

    def edges(self) -> Iterator[tuple[int, Float64[Array, 2], Float64[Array, 2], float, float]]:
        """Axis, outward normal, tangent, distance from the centre, and half length of each edge."""
        for axis in (0, 1):
            for sign in (-1.0, 1.0):
                angle = self.turn_rad + (0.5 * np.pi if axis else 0.0)
                normal = sign * np.array([np.cos(angle), np.sin(angle)])
                tangent = np.array([-normal[1], normal[0]])
                yield axis, normal, tangent, 0.5 * self.size_mm[axis], 0.5 * self.size_mm[1 - axis]


@dataclass(frozen=True, slots=True, eq=False)
class _Patch:
    """The card's surroundings in a photograph, rectified to the plane of the card's upper side."""

    name: str
    low: Float64[Array, 2]
    """Position of the first sample, mm."""
    values: Float64[Array, "h w"]
    camera: Float64[Array, 3]
    """The camera's centre relative to that plane, mm; z is its distance."""

    def at(self, places: Float64[Array, "*n 2"]) -> Float64[Array, "*n"]:
        column, row = np.moveaxis((places - self.low) / _STEP_MM, -1, 0)
        found: Float64[Array, "*n"] = map_coordinates(self.values, [row, column], order=1, mode="nearest")
        return found

    def near(self, places: Float64[Array, "*n 2"]) -> Float64[Array, "*n"]:
        """As `at`, but at the nearest pixel: five times as fast."""
        column, row = np.moveaxis(np.rint((places - self.low) / _STEP_MM).astype(int), -1, 0)
        height, width = self.values.shape
        found: Float64[Array, "*n"] = self.values[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        return found


def find_card(
    cameras: Mapping[str, Camera], photographs: Mapping[str, Photograph], board: Board, plane_mm: float
) -> CardScale | None:
    """Measure the bank card on the telephone's board. None without a card or with too few visible edges.

    Args:
        cameras: photograph → camera in the board's frame.
        photographs: name → photograph.
        board: the board, as measured or as drawn.
        plane_mm: height z of the print under the card; not 0 if the board is bowed.
    """
    drawn = board.edge_mm / FIELD_EDGE_MM
    middle = drawn * np.array(FIELD_MIDDLE)
    ink = _printed(board, drawn, middle)
    below = np.append(middle, plane_mm - CARD_THICKNESS_MM)
    rectified = (
        patch
        for name, camera in sorted(cameras.items(), key=lambda item: _obliqueness(item[1], below))
        if (patch := _rectified(name, camera, photographs[name], below)) is not None
    )
    patches = list(islice(rectified, _FEWEST))
    if len(patches) < _FEWEST:
        return None
    frontal = _Patch("", patches[0].low, np.mean([patch.values for patch in patches], axis=0), np.zeros(3))
    if _shows_print(frontal, middle, ink):
        return None  # before the other photographs are read
    patches += rectified
    card = _coarse(frontal, middle, ink)
    fitted = None
    for _ in range(4):
        places = [place for patch in patches for place in _places(patch, card, ink)]
        fitted = _fitted(card, places)
        if fitted is None:
            return None
        card = fitted[0]
    assert fitted is not None
    covariance = fitted[1] + np.diag(np.full(2, _EDGE_STD_MM**2) + np.square(CARD_TOLERANCE_MM) / 3.0)
    nominal = np.array(CARD_MM)
    relative = covariance / np.outer(nominal, nominal)
    weights = np.linalg.inv(relative).sum(axis=0)
    scale = float(weights @ (nominal / card.size_mm) / weights.sum())
    return CardScale(
        width_mm=float(card.size_mm[0]),
        height_mm=float(card.size_mm[1]),
        scale=scale,
        std=float(1.0 / np.sqrt(weights.sum())),
        photographs=len({place.photograph for place in places}),
    )


def _printed(board: Board, drawn: float, middle: Float64[Array, 2]) -> Callable[..., Array]:
    """Return a function: whether positions on the board are printed black, to one pixel."""
    low, counts = _raster(middle)
    dark = np.zeros((counts[1], counts[0]), dtype=bool)
    for left, top, width, height in np.concatenate([board.sheet().rectangles, field_sheet(drawn).rectangles]):
        first = np.ceil((np.array([left, top]) - low) / _STEP_MM).astype(int).clip(0)
        last = np.floor((np.array([left + width, top + height]) - low) / _STEP_MM).astype(int)
        dark[first[1] : max(0, last[1] + 1), first[0] : max(0, last[0] + 1)] = True

    def ink(places: Float64[Array, "*n 2"]) -> Bool[Array, "*n"]:
        column, row = np.moveaxis(np.rint((places - low) / _STEP_MM).astype(int), -1, 0)
        found: Bool[Array, "*n"] = dark[np.clip(row, 0, counts[1] - 1), np.clip(column, 0, counts[0] - 1)]
        return found

    return ink


def _raster(middle: Float64[Array, 2]) -> tuple[Float64[Array, 2], tuple[int, int]]:
    """First position of the rectified pictures, and their numbers of columns and rows."""
    half = 0.5 * np.array(CARD_MM) + _MARGIN_MM
    columns, rows = np.ceil(2 * half / _STEP_MM).astype(int)
    return middle - half, (int(columns), int(rows))


def has_field(board: CharucoTarget) -> bool:
    """Whether a board is the one of `mammometry target --telephone`, which has a field for a card."""
    stated = (list(board.squares), board.dictionary)
    return stated == (TELEPHONE_BOARD["squares"], TELEPHONE_BOARD["dictionary"]) and not board.legacy_pattern


def _obliqueness(camera: Camera, place: Float64[Array, 3]) -> float:
    """Tangent of the angle at which a camera sees a point on the board."""
    away = camera.centre_world - place
    return float(np.hypot(*away[:2]) / max(-away[2], 1e-9))


def _rectified(name: str, camera: Camera, photograph: Photograph, below: Float64[Array, 3]) -> _Patch | None:
    """The field in the plane of the card's upper side. None if the photograph does not show all of it."""
    middle, plane_mm = below[:2], float(below[2])
    low, counts = _raster(middle)
    x, y = (low[axis] + _STEP_MM * np.arange(counts[axis]) for axis in (0, 1))
    points = np.stack([*np.meshgrid(x, y), np.full((counts[1], counts[0]), plane_mm)], axis=-1)
    uv = camera.project(points)
    centre = camera.centre_world - below
    inside = np.isfinite(uv).all() and (uv >= 0).all() and (uv <= np.array(camera.size_wh) - 1).all()
    if not inside or centre[2] >= 0:
        return None
    luma = linear_luma(photograph)
    values = map_coordinates(luma, [uv[..., 1], uv[..., 0]], order=1, output=np.float64)
    return _Patch(name, low, values, np.append(camera.centre_world[:2], -centre[2]))


def _shows_print(patch: _Patch, middle: Float64[Array, 2], ink: Callable[..., Array]) -> bool:
    """Whether the squares that a card would cover are visible."""
    half = 0.5 * np.array(CARD_MM) - _ASIDE_MM - 1.0
    grid = np.stack(np.meshgrid(*(np.arange(-side, side) for side in half)), axis=-1).reshape(-1, 2) + middle
    values, dark = patch.at(grid), ink(grid)
    values, white = values - values.mean(), ~dark - np.mean(~dark)
    return bool(values @ white > _PRINT_SEEN * np.linalg.norm(values) * np.linalg.norm(white))


def _coarse(patch: _Patch, middle: Float64[Array, 2], ink: Callable[..., Array]) -> _Rectangle:
    """Position of a card of nominal size with the largest steps of brightness at all its edges.

    For each rotation, the two upright edges give the shift along x, the others the shift along y.
    """
    best = _Rectangle(middle, 0.0, np.array(CARD_MM))
    for spread in (1.0, 0.5, 0.2):
        shifts = spread * np.linspace(-_ASIDE_MM, _ASIDE_MM, 13)
        trials = []
        for turn in best.turn_rad + spread * np.linspace(-_TURNED_RAD, _TURNED_RAD, 9):
            score, moved = 0.0, best.middle
            for axis in (0, 1):
                places = [moved + shift * np.eye(2)[axis] for shift in shifts]
                scores = [_contrast(patch, _Rectangle(place, turn, best.size_mm), axis, ink) for place in places]
                score, moved = score + max(scores), places[int(np.argmax(scores))]
            trials.append((score, turn, moved))
        _, turn, moved = max(trials, key=lambda trial: trial[0])
        best = _Rectangle(moved, float(turn), best.size_mm)
    return best


def _contrast(patch: _Patch, card: _Rectangle, axis: int, ink: Callable[..., Array]) -> float:
    """Step of brightness at a card's edges across an axis, where the print next to them is uniform."""
    total = 0.0
    for of, normal, tangent, far, half in card.edges():
        if of != axis:
            continue
        along = np.arange(-half + _ROUND_MM, half - _ROUND_MM, 3.0)
        edge = card.middle + far * normal + along[:, None] * tangent
        outside = edge[:, None] + np.array([0.4, 1.0, 1.6])[:, None] * normal
        dark = ink(outside)
        plain = dark.all(axis=1) | ~dark.any(axis=1)
        steps = np.abs(patch.near(outside[:, 1]) - patch.near(edge - 0.8 * normal))[plain]
        total += float(np.sqrt(steps.mean())) if len(steps) else 0.0
    return total


@dataclass(frozen=True, slots=True)
class _Place:
    """Point of an edge, measured in a photograph."""

    photograph: str
    axis: int
    normal: tuple[float, float]
    along_mm: float
    offset_mm: float
    """Distance outwards from the edge in the previous round, mm."""
    outwards: float
    """Tangent of the viewing angle, positive if the camera is outside the edge."""


def _places(patch: _Patch, card: _Rectangle, ink: Callable[..., Array]) -> Iterator[_Place]:
    white = float(np.percentile(patch.values, 95))
    across = np.arange(-_REACH_MM, _REACH_MM + 1e-9, _PROFILE_MM)
    beyond = across >= -0.3
    for axis, normal, tangent, far, half in card.edges():
        outwards = float((patch.camera[:2] - card.middle - far * normal) @ normal / patch.camera[2])
        if not -_OBLIQUE < outwards < _WALL:
            continue
        along = np.arange(-half + _ROUND_MM, half - _ROUND_MM, _ALONG_MM)
        edge = card.middle + far * normal + along[:, None] * tangent
        places = edge[:, None] + across[:, None] * normal
        profiles, dark = patch.at(places), ink(places[:, beyond])
        kind = np.where(dark.all(axis=1), 1, np.where(dark.any(axis=1), -1, 0))
        mixed = np.flatnonzero(kind[1:] != kind[:-1])
        for border in mixed:  # profiles blurred by the print next to them
            kind[max(0, border + 1 - _BLURRED) : border + 1 + _BLURRED] = -1
        chunk = np.floor((along + half) / _CHUNK_MM).astype(int)
        for (_, inked), group in groupby(range(len(along)), key=lambda k: (chunk[k], kind[k])):
            rows = list(group)
            if inked < 0 or len(rows) < 4:
                continue
            offset = _crossing(across, profiles[rows].mean(axis=0), white)
            if offset is not None:
                yield _Place(
                    patch.name, axis, (float(normal[0]), float(normal[1])), float(along[rows].mean()), offset, outwards
                )


def _crossing(across: Float64[Array, " t"], profile: Float64[Array, " t"], white: float) -> float | None:
    """Where a profile crosses the mean brightness of both sides, mm. None without a clear step."""
    near, far = _PLATEAU_MM
    inside = float(np.median(profile[(across >= -far) & (across <= -near)]))
    outside = float(np.median(profile[(across >= near) & (across <= far)]))
    if abs(inside - outside) < _LEAST_STEP * white:
        return None
    rest = (profile - 0.5 * (inside + outside)) * (1.0 if outside > inside else -1.0)
    found = [k for k in np.flatnonzero((rest[:-1] < 0) & (rest[1:] >= 0)) if abs(across[k]) <= _MOST_OFF_MM]
    if len(found) != 1:
        return None
    k = found[0]
    return float(across[k] + _PROFILE_MM * rest[k] / (rest[k] - rest[k + 1]))


def _fitted(card: _Rectangle, places: list[_Place]) -> tuple[_Rectangle, Float64[Array, "2 2"]] | None:
    """Rectangle that fits all points, and the covariance of its sides. None with too few points on an edge.

    Unknowns: shift of the middle, rotation, changes of both sides, height of the card above its nominal plane.
    """
    normals = np.array([place.normal for place in places]).reshape(-1, 2)
    axes = np.array([place.axis for place in places], dtype=int)
    signs = np.array([1.0 if place.normal[place.axis] > 0 else -1.0 for place in places])
    if any(np.count_nonzero((axes == axis) & (signs == sign)) < _FEWEST for axis in (0, 1) for sign in (-1.0, 1.0)):
        return None
    rows = np.column_stack(
        [
            normals,
            [-place.along_mm for place in places],
            0.5 * (axes == 0),
            0.5 * (axes == 1),
            [place.outwards for place in places],
        ]
    )
    offsets = np.array([place.offset_mm for place in places])
    prior = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    weights, step, sigma = np.ones(len(places)), np.zeros(6), 1.0
    for _ in range(10):
        normal = (rows.T * weights) @ rows + (sigma / _LIFT_STD_MM) ** 2 * prior
        step = np.linalg.solve(normal, (rows.T * weights) @ offsets)
        rest = offsets - rows @ step
        sigma = max(MAD * float(np.median(np.abs(rest))), 1e-4)
        weights = np.minimum(1.0, _HUBER * sigma / np.maximum(np.abs(rest), 1e-9))
    inverse = np.linalg.inv(normal)
    # Errors within a photograph are correlated: all its points count as one observation.
    names = np.array([place.photograph for place in places])
    sums = np.stack(
        [(rows[names == name].T * weights[names == name]) @ rest[names == name] for name in np.unique(names)]
    )
    sums = np.concatenate([sums, [[0, 0, 0, 0, 0, sigma**2 / _LIFT_STD_MM]]])
    covariance = inverse @ (sums.T @ sums) @ inverse
    moved = _Rectangle(card.middle + step[:2], card.turn_rad + float(step[2]), card.size_mm + step[3:5])
    return moved, covariance[3:5, 3:5]
