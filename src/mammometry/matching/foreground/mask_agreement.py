"""Whether all cameras' silhouettes can be of one subject.

Points in the working volume that the pairs see must lie within every silhouette. And what all silhouettes have in
common, their visual hull, must fill each of them: one that is much too small, too large or inverted does not fit the
others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Camera, Rig

# Chosen on the captures of benchmarks.accuracy.foreground; right silhouettes are above .9 in both.
_WITHIN = 0.4  # of the pairs' points in the picture, that a silhouette must hold at least
_FEWEST = 150  # of them, fewer tell nothing
_FILLED = 0.5  # of a silhouette, that the hull must fill at least
_GRID = 48  # of the hull, along each side
_MOST = 0.5  # of a cell, that makes it the silhouette's
_REACH = 0.7  # half the grid's side, of the pictures' height at the subject's middle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Checked:
    """Silhouettes that fit one another, and those that do not."""

    masks: Mapping[str, Bool[Array, "h w"]]
    """Camera → the subject's blocks, without parts that the others contradict."""
    doubts: Mapping[str, str]
    """Camera → why its silhouette is not one of them."""


def check_masks(
    rig: Rig,
    masks: Mapping[str, Bool[Array, "h w"]],
    steps: Mapping[str, int],
    seen: Sequence[tuple[Set[str], Float64[Array, "n 3"]]],
    middle_world: Float64[Array, 3],
) -> Checked:
    """Compare the cameras' silhouettes.

    Args:
        rig: calibrated cameras.
        masks: camera → the subject's blocks.
        steps: camera → pixels to one of its blocks.
        seen: of each pair, its cameras and points of the working volume that it sees, world frame, mm.
        middle_world: about which the subject stands, mm.
    """
    doubts = {}
    for name, mask in masks.items():
        others = [points for cameras, points in seen if name not in cameras] or [points for _, points in seen]
        rows, columns, inside = _in_blocks(rig.cameras[name], np.concatenate([*others, np.empty((0, 3))]), steps[name])
        within = mask[rows[inside], columns[inside]]
        if len(within) >= _FEWEST and within.mean() < _WITHIN:
            doubts[name] = f"only {100 * within.mean():.0f} % of what the pairs see near lies within its silhouette"
    left = {name: mask for name, mask in masks.items() if name not in doubts}
    grid = _grid(rig, middle_world)
    places = {name: _in_blocks(rig.cameras[name], grid, steps[name]) for name in left}
    while len(left) > 1:
        filled = _filled(left, places)
        if min(float(cells[part].mean()) if part.any() else 0.0 for part, cells, _ in filled.values()) >= _FILLED:
            left = {name: _parts(mask, *filled[name]) for name, mask in left.items()}
            break
        worst = max(left, key=lambda name: _least_filled({k: v for k, v in left.items() if k != name}, places))
        share = 100 * left.pop(worst).mean()
        doubts[worst] = f"its silhouette of {share:.0f} % of the picture does not fit the other cameras'"
    return Checked(masks=left, doubts=doubts)


def _grid(rig: Rig, middle_world: Float64[Array, 3]) -> Float64[Array, "n 3"]:
    """A cube about the subject's middle, as large as the pictures there."""
    heights = [
        float(np.linalg.norm(middle_world - camera.centre_world)) * min(camera.size_wh) / float(camera.matrix[0, 0])
        for camera in rig.cameras.values()
    ]
    ticks = _REACH * float(np.median(heights)) * np.linspace(-1.0, 1.0, _GRID)
    cube = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    points: Float64[Array, "n 3"] = middle_world + cube
    return points


def _in_blocks(
    camera: Camera, points_world: Float64[Array, "n 3"], step: int
) -> tuple[Array, Array, Bool[Array, " n"]]:
    """Block's row and column of each point, and whether it lies in the picture."""
    uv = camera.project(points_world)
    with np.errstate(invalid="ignore"):
        inside = np.all((uv > -0.5) & (uv < np.array(camera.size_wh) - 0.5), axis=1)
    places = np.where(inside[:, None], np.rint(uv), 0).astype(np.intp) // step
    return places[:, 1], places[:, 0], inside


_Places = Mapping[str, tuple[Array, Array, Bool[Array, " n"]]]


def _least_filled(masks: Mapping[str, Bool[Array, "h w"]], places: _Places) -> float:
    shares = [float(cells[part].mean()) if part.any() else 0.0 for part, cells, _ in _filled(masks, places).values()]
    return min(shares)


def _filled(
    masks: Mapping[str, Bool[Array, "h w"]], places: _Places
) -> dict[str, tuple[Bool[Array, "H W"], Bool[Array, "H W"], int]]:
    """Camera → its silhouette's cells before what other cameras see, cells that the hull fills, blocks to a cell."""
    hull, seen = np.ones(_GRID**3, dtype=bool), np.zeros(_GRID**3, dtype=np.int16)
    for name, mask in masks.items():
        rows, columns, inside = places[name]
        hull &= ~inside | mask[rows, columns]
        seen += inside
    found = {}
    for name, mask in masks.items():
        rows, columns, inside = places[name]
        by_others = inside & (seen > 1)
        cell = max(1, round(float(np.hypot(*mask.shape)) / _GRID))
        size = tuple(length // cell + 1 for length in mask.shape)
        pictures = np.zeros((2, *size), dtype=bool)
        for picture, chosen in zip(pictures, (by_others, by_others & hull), strict=True):
            picture[rows[chosen] // cell, columns[chosen] // cell] = True
        padded = np.pad(mask, [(0, count * cell - length) for count, length in zip(size, mask.shape, strict=True)])
        most = padded.reshape(size[0], cell, size[1], cell).mean(axis=(1, 3)) >= _MOST
        found[name] = most & pictures[0], pictures[1], cell
    return found


def _parts(
    mask: Bool[Array, "h w"], part: Bool[Array, "H W"], filled: Bool[Array, "H W"], cell: int
) -> Bool[Array, "h w"]:
    """The silhouette without connected parts that the hull hardly fills."""
    labels, count = ndimage.label(mask)
    if count < 2:
        return mask
    rows, columns = (np.arange(length) // cell for length in mask.shape)
    judged, kept = part[np.ix_(rows, columns)], filled[np.ix_(rows, columns)]
    numbers = np.arange(count + 1)
    sizes = np.maximum(ndimage.sum_labels(judged, labels, numbers), 1)
    alone = ndimage.sum_labels(judged & ~kept, labels, numbers) > (1 - _FILLED) * sizes
    alone[0] = False
    return mask & ~alone[labels]
