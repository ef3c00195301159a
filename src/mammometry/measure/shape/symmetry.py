"""Comparison of the left breast with the right one, mirrored at the trunk's mid-sagittal plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mammometry.base.machine.cores import available_cores
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Transform, TriangleMesh
from mammometry.geometry.nearest import point_tree
from mammometry.measure.trunk.body import within_boundary
from mammometry.measure.trunk.mirror_plane import MirrorPlane, mirror, register
from mammometry.measure.volume.difference import difference
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_OBLIQUE, _FLUSH_MM = 0.8, 3.0
"""Largest distance of a counterpart from the normal: share of the distance along it, or mm if larger. Not critical."""
_FARTHEST_MM = 80.0  # largest distance of a counterpart; not critical


@value(eq=False)
class Symmetry:
    """Differences between the breasts of a torso."""

    plane_point_world: Float64[Array, 3]
    """A point of the mid-sagittal plane, mm."""
    plane_normal_world: Float64[Array, 3]
    """Its unit normal, towards the patient's left."""
    plane_sigma_mm: float
    """Standard uncertainty of the plane's position along its normal, mm."""
    trunk_scatter_mm: float
    """Robust standard deviation of the trunk, without the breasts, from its mirror image, mm."""
    left_from_mirrored: Transform
    """Rigid motion of the mirrored right breast onto the left one."""
    shift_mm: Float64[Array, 3]
    """Shift of the mirrored right breast's centre by that motion, mm: to the patient's left, the head, ahead."""
    turn_deg: float
    """Rotation angle of that motion, degrees."""
    difference_cc: float
    """Volume left minus right, cc."""
    difference_interval_cc: tuple[float, float] | None
    """Its 95 % interval without errors that both sides share (`volume.difference`), cc. None if a volume has none."""
    ratio: float
    """Volume of the smaller breast over that of the larger."""
    rms_mirrored_mm: float
    """RMS distance of the left skin from the mirrored right one before registration, mm: position and shape."""
    rms_mm: float
    """RMS distance after registration, mm: shape alone."""
    left_mm: Float64[Array, " n"]
    """For each vertex of the left closed solid, signed distance of the left skin in front of the registered, mirrored
    right one, mm. NaN on the wall and where there is no counterpart."""
    right_mm: Float64[Array, " m"]
    """For each vertex of the right closed solid, signed distance of the right skin in front of the left one, mm."""

    def mirrored(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Points of the right side, mirrored and registered to the left, mm, world frame."""
        plain = mirror(points_world, self.plane_point_world, self.plane_normal_world)
        return self.left_from_mirrored.apply(plain)


def symmetry(
    measurements: Sequence[VolumeMeasurement], frame: Float64[Array, "3 3"], plane: MirrorPlane
) -> Symmetry | None:
    """Differences between left and right. None unless both were measured.

    Args:
        measurements: measurements of both breasts.
        frame: rows: the patient's left, the head, straight ahead; world frame.
        plane: the mid-sagittal plane of the trunk without breasts.

    Raises:
        MeasureError: the breasts do not match at all.
    """
    sides = {measured.name: measured for measured in measurements}
    if not {"left", "right"} <= set(sides):
        return None
    left, right = sides["left"], sides["right"]
    point, normal = plane.point_world, plane.normal_world
    skins = {name: measured.skin for name, measured in sides.items()}
    mirrored_right = skins["right"].mapped(lambda points: mirror(points, point, normal)).turned_over()
    motion = register(
        (mirrored_right.vertices, mirrored_right.vertex_normals()),
        (skins["left"].vertices, skins["left"].vertex_normals()),
        subject="left and mirrored right breast",
    ).fixed_from_moving
    laid = mirrored_right.transformed(motion)
    back = skins["left"].transformed(motion.inverse())
    before, after = signed_mm(skins["left"], mirrored_right), signed_mm(skins["left"], laid)
    other = signed_mm(mirrored_right, back)
    middle = mirrored_right.vertices.mean(axis=0)
    apart = difference(left, right, "sides")
    volumes = left.volume_cc, right.volume_cc
    return Symmetry(
        plane_point_world=point,
        plane_normal_world=normal,
        plane_sigma_mm=plane.sigma_mm,
        trunk_scatter_mm=plane.scatter_mm,
        left_from_mirrored=motion,
        shift_mm=frame @ (motion.apply(middle) - middle),
        turn_deg=float(np.rad2deg(np.linalg.norm(motion.rotation_vector_rad))),
        difference_cc=apart.difference_cc,
        difference_interval_cc=apart.difference_interval_cc,
        ratio=min(volumes) / max(volumes),
        rms_mirrored_mm=rms_mm(skins["left"], before),
        rms_mm=rms_mm(skins["left"], after),
        left_mm=_on_solid(left, after),
        right_mm=_on_solid(right, other),
    )


def trunk_skin(
    surface: RepairedSurface, boundaries: Sequence[Float64[Array, "_ 3"]]
) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"]]:
    """Visible vertices at least 10 mm outside every boundary, and their normals."""
    seen = surface.provenance != Provenance.INVENTED
    seen &= np.bincount(surface.mesh.faces.ravel(), minlength=len(seen)) > 0
    if not seen.any():
        seen[:] = True
    for boundary in boundaries:
        seen &= ~within_boundary(surface.mesh.vertices, boundary)
    return surface.mesh.vertices[seen], surface.mesh.vertex_normals()[seen]


def signed_mm(
    skin: TriangleMesh, other: TriangleMesh, *, selected: Bool[Array, " n"] | None = None
) -> Float64[Array, " n"]:
    """Signed distance of each vertex from another, finely triangulated surface, mm, positive outside.

    It is the distance from the tangent plane at the nearest vertex. NaN without a counterpart: beyond the other's edge,
    where the offset to the nearest vertex runs along the surface, or more than 80 mm away.

    Args:
        skin: the surface whose vertices are compared.
        other: the surface that they are compared with.
        selected: vertices to compare; the others are NaN. None: all.
    """
    selected = np.ones(len(skin.vertices), dtype=bool) if selected is None else selected
    found = np.full(len(skin.vertices), np.nan)
    points = skin.vertices[selected]
    tree = point_tree(other.vertices)
    distance, place = tree.query(points, distance_upper_bound=_FARTHEST_MM, workers=available_cores())
    near = np.isfinite(distance)
    nearest = np.asarray(place)[near]
    away = points[near] - other.vertices[nearest]
    normals = other.vertex_normals()[nearest]
    signed = (away * normals).sum(axis=1)
    along = np.linalg.norm(away - normals * signed[:, None], axis=1)
    values = np.full(len(points), np.nan)
    values[near] = np.where(along <= np.maximum(_FLUSH_MM, _OBLIQUE * np.abs(signed)), signed, np.nan)
    found[selected] = values
    return found


def rms_mm(skin: TriangleMesh, values_mm: Float64[Array, " n"]) -> float:
    """Area-weighted RMS of the finite values on vertices."""
    areas = np.linalg.norm(skin.face_vectors(), axis=1)
    weight = np.bincount(skin.faces.ravel(), np.repeat(areas, 3), minlength=len(skin.vertices))
    known = np.isfinite(values_mm)
    return float(np.sqrt((weight * values_mm**2)[known].sum() / np.maximum(weight[known].sum(), 1e-12)))


def _on_solid(measured: VolumeMeasurement, values: Float64[Array, " n"]) -> Float64[Array, " m"]:
    """Values on the skin's vertices, extended by NaN to all vertices of the solid."""
    result = np.full(len(measured.closed.vertices), np.nan)
    result[measured.closed.vertices_used_by(np.arange(measured.skin_faces))] = values
    return result
