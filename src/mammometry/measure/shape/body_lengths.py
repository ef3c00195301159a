"""Lengths of a torso that are compared with those of adults."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.notices.words import maybe_words
from mammometry.geometry import Array, Float64
from mammometry.measure.landmarks.nipple import propose_nipple
from mammometry.measure.landmarks.proposals import propose_on_midline
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.shape.body_size import BodySize
from mammometry.measure.trunk.body import BodyDirections
from mammometry.measure.trunk.thorax import seen_skin, trunk_breadth_mm
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.surface.repair.repair import RepairedSurface

_GREY = 128  # colour given to all skin, so that nipples are found from the shape alone


@contextmanager
def size_remarked(surface: RepairedSurface, frame: Float64[Array, "3 3"]) -> Iterator[None]:
    """Context in which errors mention an unusual breadth of the trunk: the scale may be wrong."""
    try:
        yield
    except MeasureError as error:
        size = BodySize(lengths_mm=_trunk(surface, frame, None))
        raise error.with_remark(maybe_words(size.notice if size.is_rare else None)) from None


def find_body_size(
    surface: RepairedSurface,
    breasts: Sequence[OpenBreast],
    body: BodyDirections,
    settings: MeasureSettings = MeasureSettings(),
) -> BodySize:
    """Breadth of the trunk, distance of the nipples, and distance of the notch from a nipple, if visible.

    Picked landmarks are not used, so that no volume depends on them.

    Args:
        surface: the repaired mesh, world frame, mm.
        breasts: the breasts cut out of it.
        body: the body frame.
        settings: least probability of a nipple.
    """
    curves = [breast.boundary.points_world for breast in breasts]
    middle = np.mean([curve.mean(axis=0) for curve in curves], axis=0) if curves else None
    found = _trunk(surface, body.frame, middle)
    nipples = _nipples(breasts, settings)
    if len(nipples) == 2:
        found["nipples"] = float(np.linalg.norm(np.subtract(*nipples.values())))
    notch = _notch(surface, curves, body)
    if notch is not None and nipples:
        found["notch"] = float(np.mean([np.linalg.norm(place - notch) for place in nipples.values()]))
    return BodySize(lengths_mm=found)


def _trunk(
    surface: RepairedSurface, frame: Float64[Array, "3 3"], middle: Float64[Array, 3] | None
) -> dict[str, float]:
    try:
        breadth_mm = trunk_breadth_mm(seen_skin(surface), frame, height_of=middle)
    except MeasureError:
        return {}
    return {} if breadth_mm is None else {"trunk": breadth_mm}


def _nipples(breasts: Sequence[OpenBreast], settings: MeasureSettings) -> dict[str, Float64[Array, 3]]:
    """Side → nipple found from the shape, world frame, mm."""
    found: dict[str, Float64[Array, 3]] = {}
    for breast in breasts:
        name = f"nipple_{breast.boundary.name}"
        try:
            skin = breast.part.mesh
        except MeasureError:
            continue  # the measurement reports the error
        grey = np.full((len(skin.vertices), 3), _GREY, dtype=np.uint8)
        mark = propose_nipple(name, skin, grey, breast.boundary.points_world)
        if mark is not None and mark.probability >= settings.nipple.least_probability:
            found[name] = mark.points_world[0]
    return found


def _notch(
    surface: RepairedSurface, curves: Sequence[Float64[Array, "_ 3"]], body: BodyDirections
) -> Float64[Array, 3] | None:
    if body.plane is None or not curves:
        return None
    heights = (np.concatenate(curves) - body.point_world) @ body.up
    marks = propose_on_midline(
        surface.mesh, body.frame, body.point_world, body.plane.sigma_mm, float(heights.min()), float(heights.max())
    )
    return next((mark.points_world[0] for mark in marks if mark.name == "sternal_notch"), None)
