"""Volume deficit of one side of a torso relative to the mirrored other side.

It is the volume between the fuller side's skin, mirrored at the trunk's mid-sagittal plane, and the skin of this side.
It needs one curve, on the fuller side, and no chest wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from mammometry.base.errors import MeasureError
from mammometry.base.normal import COVERAGE_95
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import BodyDirections
from mammometry.measure.trunk.mirror_plane import MirrorPlane
from mammometry.measure.trunk.thorax import Trunk
from mammometry.measure.volume.boundary_jitter import ORDERS
from mammometry.measure.volume.measurement import VolumeDeficit, VolumeMeasurement
from mammometry.measure.volume.sources import AXIS, WALL, WALL_SIDES_U95_MM
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.surface.repair.repair import RepairedSurface

_STEP_MM = 2.0  # grid spacing of the sum between both walls; chosen for speed
_WALL = "cylinder-membrane"
_NEAREST_MM = 25.0  # largest distance of the mirrored curve from the skin of this side; not critical


def volume_deficit(
    surface: RepairedSurface,
    measurements: Sequence[VolumeMeasurement],
    body: BodyDirections,
    settings: MeasureSettings = MeasureSettings(),
) -> VolumeDeficit | None:
    """Volume deficit of the smaller side. None without a measured breast or a mid-sagittal plane.

    Let W be the fuller breast's wall, V its volume, and a prime the mirror image. The deficit is

        V − V₂ − ∫ (r₂² − r′²)/2 dθ dy

    V₂ is the volume of the other side within the mirrored boundary, in front of a membrane of its own with radius r₂,
    and r′ is the radius of W′. The walls cancel: the result is the volume between the mirrored skin and this side's.

    Args:
        surface: the repaired mesh, world frame, mm.
        measurements: measurements of one or both breasts.
        body: the body frame with its mid-sagittal plane.
        settings: uncertainty of the boundary.

    Raises:
        MeasureError: the mirrored boundary is not on the skin of the other side, or cannot be followed there.
    """
    sides = [measured for measured in measurements if measured.name != "model"]
    plane = body.plane
    if not sides or plane is None:
        return None
    fuller = max(sides, key=lambda measured: measured.volume_cc)
    name: Literal["left", "right"] = "right" if fuller.name == "left" else "left"
    curve = plane.mirrored(fuller.boundary_world)[::-1]
    foot = closest_on_mesh(curve, surface.mesh)
    if float(np.quantile(foot.distances_mm, 0.9)) > _NEAREST_MM:
        raise MeasureError(
            f"the patient's {name} side",
            found="no skin at the mirrored boundary of the other breast",
            expected="a trunk that is visible on both sides",
            remedy="Photograph the trunk from both sides",
            mesh_remedy="Scan the trunk from both sides",
        )
    boundary = Boundary(name=name, points_world=foot.points, method="the other side's, mirrored")
    others = [Boundary(name=fuller.name, points_world=fuller.boundary_world, method=fuller.boundary_method), boundary]
    breast = open_breasts(others, surface, settings, frame=body.frame)[1]
    own = chest_wall.fit(breast, _WALL)
    gap_cc, distance_mm = _between(
        breast.trunk, own.mesh.vertices, plane.mirrored(fuller.wall.vertices), foot.points, curve
    )
    volume_cc = fuller.volume_cc - own.closed.volume_mm3() / 1000 - gap_cc
    terms = _terms(fuller, plane, distance_mm, settings) if fuller.interval_cc is not None else {}
    half = float(np.sqrt(sum(term**2 for term in terms.values())))
    return VolumeDeficit(
        name=name,
        volume_cc=volume_cc,
        interval_cc=(volume_cc - half, volume_cc + half) if terms else None,
        terms_cc=terms,
        curves=len(sides),
        boundary_world=foot.points,
        note=f"What lies between the {fuller.name} breast's skin, mirrored at the trunk's mid-sagittal plane, and the "
        f"skin of the {name} side. It needs the boundary of the {fuller.name} breast only, and no chest wall. What one "
        "side's chest stands further out than the other's is part of it"
        + (f". The interval covers {', '.join(terms)}" if terms else ""),
    )


def _between(
    trunk: Trunk,
    wall_world: Float64[Array, "n 3"],
    mirrored_world: Float64[Array, "m 3"],
    rim_world: Float64[Array, "b 3"],
    mirrored_rim_world: Float64[Array, "b 3"],
) -> tuple[float, float]:
    """Volume between two walls, cc, and the RMS distance of their rims, mm."""
    first, second = (trunk.cylindrical(points) for points in (wall_world, mirrored_world))
    rims = [trunk.cylindrical(points) for points in (rim_world, mirrored_rim_world)]
    low, high = first[:, :2].min(axis=0), first[:, :2].max(axis=0)
    across, up = (np.arange(low[k], high[k], _STEP_MM) for k in (0, 1))
    flat = np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
    radii = [LinearNDInterpolator(surface[:, :2], surface[:, 2])(flat) for surface in (first, second)]
    inside = _within(flat, rims[0][:, :2]) & np.isfinite(radii[0]) & np.isfinite(radii[1])
    cell = _STEP_MM**2 / trunk.half_width_mm  # dθ dy
    volume_mm3 = float(((radii[0][inside] ** 2 - radii[1][inside] ** 2) / 2).sum() * cell)
    return volume_mm3 / 1000, float(np.sqrt(np.mean((rims[0][:, 2] - rims[1][:, 2]) ** 2)))


def _within(flat: Float64[Array, "n 2"], outline: Float64[Array, "k 2"]) -> Array:
    """Whether points are inside a closed polygon (even–odd rule)."""
    inside = np.zeros(len(flat), dtype=bool)
    for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        crosses = (ay > flat[:, 1]) != (by > flat[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= crosses & (flat[:, 0] < (bx - ax) * (flat[:, 1] - ay) / (by - ay) + ax)
    return inside


def _terms(
    fuller: VolumeMeasurement, plane: MirrorPlane, distance_mm: float, settings: MeasureSettings
) -> dict[str, float]:
    """Half-widths at 95 %, cc, of independent sources.

    - Asymmetry of the trunk: the scatter of its skin beside the breasts, common to the whole base, but at least
      `WALL_SIDES_U95_MM` per side, the difference of real women's chests behind the breasts.
    - Mid-sagittal plane: mirrored skin moves by twice the plane's error.
    - Boundary: a displaced curve adds or removes a strip as thick as the distance between both skins.
    - Errors of the skin count twice, once per side.
    """
    base_cm2 = fuller.base_area_cm2
    loop = np.concatenate([fuller.boundary_world, fuller.boundary_world[:1]])
    length_mm = float(np.linalg.norm(np.diff(loop, axis=0), axis=1).sum())
    strip_mm3 = settings.observers.mean_mm * distance_mm * length_mm / np.sqrt(ORDERS)
    behind_mm = float(np.sqrt(2)) * WALL_SIDES_U95_MM
    terms = {
        "asymmetry of the trunk": max(COVERAGE_95 * plane.scatter_mm, behind_mm) * base_cm2 / 10,
        "mid-sagittal plane": COVERAGE_95 * 2 * plane.sigma_mm * base_cm2 / 10,
        "boundary": COVERAGE_95 * float(strip_mm3) / 1000,
    }
    own = {name: term for name, term in fuller.interval_terms_cc.items() if name not in (WALL, AXIS, "boundary")}
    return terms | {name: float(np.sqrt(2)) * term for name, term in own.items()}
