"""Whether all cameras' silhouettes can be of one subject.

Points in the working volume that the pairs see must lie within every silhouette. And what all silhouettes have in
common, their visual hull, must fill each of them: one that is much too small, too large or inverted does not fit the
others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Camera, Rig

# Chosen on the captures of benchmarks.accuracy.foreground; right silhouettes are above .9 in both.
_WITHIN = 0.4  # of the pairs' points in the picture, that a silhouette must hold at least
_FEWEST = 150  # of them, fewer tell nothing
_FILLED = 0.5  # of a silhouette, that the hull must fill at least
_GRID = 48  # of the hull, along each side
_REACH = 0.7  # half the grid's side, of the pictures' height at the subject's middle


def contradicted(
    rig: Rig,
    masks: Mapping[str, Bool[Array, "h w"]],
    steps: Mapping[str, int],
    seen: Sequence[tuple[Set[str], Float64[Array, "n 3"]]],
    middle_world: Float64[Array, 3],
) -> dict[str, str]:
    """Cameras whose silhouettes others contradict, each with the reason.

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
    if len(left) < 2:
        return doubts
    grid = _grid(rig, middle_world)
    places = {name: _in_blocks(rig.cameras[name], grid, steps[name]) for name in left}
    while len(left) > 1:
        filled = _filled(left, places)
        if min(filled.values()) >= _FILLED:
            break
        without = {
            name: min(_filled({other: mask for other, mask in left.items() if other != name}, places).values())
            for name in left
        }
        worst = max(without, key=lambda name: without[name])
        share = 100 * left.pop(worst).mean()
        doubts[worst] = f"its silhouette of {share:.0f} % of the picture does not fit the other cameras'"
    return doubts


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


def _filled(
    masks: Mapping[str, Bool[Array, "h w"]], places: Mapping[str, tuple[Array, Array, Bool[Array, " n"]]]
) -> dict[str, float]:
    """Camera → share of its silhouette, within the grid's picture, that the hull of all fills."""
    hull = np.ones(_GRID**3, dtype=bool)
    for name, mask in masks.items():
        rows, columns, inside = places[name]
        hull &= ~inside | mask[rows, columns]
    found = {}
    for name, mask in masks.items():
        rows, columns, inside = places[name]
        cell = max(1, round(np.hypot(*mask.shape) / _GRID))
        size = tuple(length // cell + 1 for length in mask.shape)
        counts = [np.zeros(size, dtype=bool) for _ in range(2)]
        for picture, chosen in zip(counts, (inside, inside & hull), strict=True):
            picture[rows[chosen] // cell, columns[chosen] // cell] = True
        anywhere, filled = (ndimage.binary_dilation(picture, iterations=1) for picture in counts)
        of_mask = np.zeros(size, dtype=bool)
        of_mask[tuple(np.array(np.nonzero(mask)) // cell)] = True
        of_mask &= anywhere
        found[name] = float(filled[of_mask].mean()) if of_mask.any() else 0.0
    return found
