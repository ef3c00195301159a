"""Left breast against the mirrored right one, at the mid-sagittal plane of the trunk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mammometry.geometry.arrays import Array, Bool, Float64, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.measure.trunk.register import register
from mammometry.measure.volume.volume import VolumeMeasurement
from mammometry.surface.repair import Provenance, RepairedSurface

_PLANE_ROUNDS = 4  # of mirroring and registering; it ends when the plane is at rest
_AT_REST_RAD = 1e-4  # a plane that turns by less is at rest
_BESIDE_MM = 10.0  # skin this near to a boundary counts as breast; chosen by eye
_OBLIQUE, _FLUSH_MM = 0.8, 3.0
"""A counterpart lies beside the normal by no more than this share of its distance along it, or by this much. Chosen by
eye."""
_FARTHEST_MM = 80.0  # a counterpart is looked for within this distance; chosen by eye
_WINDOW_MM = 250.0  # skin this near to the breasts' middle shows the plane; chosen by eye


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Symmetry:
    """How both breasts of a torso differ."""

    plane_point_world: Float64[Array, 3]
    """A point of the mid-sagittal plane, mm."""
    plane_normal_world: Float64[Array, 3]
    """Its unit normal, towards the patient's left."""
    plane_sigma_mm: float
    """Standard uncertainty of the plane's place along its normal, mm."""
    trunk_scatter_mm: float
    """Robust standard deviation of the trunk from its own mirror image without the breasts, mm."""
    left_from_mirrored: Transform
    """Rigid motion that lays the right breast, mirrored at the plane, onto the left one."""
    shift_mm: Float64[Array, 3]
    """How that motion moves the middle of the mirrored right breast, mm: to the patient's left, the head, ahead."""
    turn_deg: float
    """Angle of that motion, degrees."""
    difference_cc: float
    """Volume left minus right, cc."""
    ratio: float
    """Volume of the smaller breast over that of the larger."""
    rms_mirrored_mm: float
    """Root mean square distance of the left skin from the mirrored right one as they lie, mm: place and shape."""
    rms_mm: float
    """Root mean square distance after the rigid motion, mm: shape alone."""
    left_mm: Float64[Array, " n"]
    """For each vertex of the left closed solid: how far the left skin stands out of the registered mirrored right one,
    mm; NaN on the wall and where the other skin has no counterpart."""
    right_mm: Float64[Array, " m"]
    """For each vertex of the right closed solid: how far the right skin stands out of the left one, mm."""

    def __post_init__(self) -> None:
        for name in ("plane_point_world", "plane_normal_world", "shift_mm", "left_mm", "right_mm"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def mirrored(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Points of the right side mirrored at the plane and laid onto the left one, world frame, mm."""
        plain = mirror(points_world, self.plane_point_world, self.plane_normal_world)
        return self.left_from_mirrored.apply(plain)


def mirror(
    points: Float64[Array, "n 3"], plane_point: Float64[Array, 3], plane_normal: Float64[Array, 3]
) -> Float64[Array, "n 3"]:
    """Mirror points at a plane."""
    return points - 2 * ((points - plane_point) @ plane_normal)[:, None] * plane_normal


def symmetry(
    surface: RepairedSurface, measurements: Sequence[VolumeMeasurement], frame: Float64[Array, "3 3"]
) -> Symmetry | None:
    """Compare both breasts. None unless both were measured.

    Args:
        surface: the whole torso.
        measurements: of both breasts.
        frame: rows: the patient's left, the head, straight ahead, roughly; world frame.

    Raises:
        MeasureError: too little of the trunk was seen on both sides, or the breasts do not match at all.
    """
    sides = {measured.name: measured for measured in measurements}
    if not {"left", "right"} <= set(sides):
        return None
    left, right = sides["left"], sides["right"]
    point, normal, scatter, sigma = mid_sagittal_plane(surface, (left, right), frame)
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
    volumes = left.volume_cc, right.volume_cc
    return Symmetry(
        plane_point_world=point,
        plane_normal_world=normal,
        plane_sigma_mm=sigma,
        trunk_scatter_mm=scatter,
        left_from_mirrored=motion,
        shift_mm=frame @ (motion.apply(middle) - middle),
        turn_deg=float(np.rad2deg(np.linalg.norm(motion.rotation_vector_rad))),
        difference_cc=volumes[0] - volumes[1],
        ratio=min(volumes) / max(volumes),
        rms_mirrored_mm=rms_mm(skins["left"], before),
        rms_mm=rms_mm(skins["left"], after),
        left_mm=_on_solid(left, after),
        right_mm=_on_solid(right, other),
    )


def mid_sagittal_plane(
    surface: RepairedSurface, measurements: Sequence[VolumeMeasurement], frame: Float64[Array, "3 3"]
) -> tuple[Float64[Array, 3], Float64[Array, 3], float, float]:
    """Find the plane about which the trunk without its breasts is most nearly its own mirror image.

    The trunk is mirrored at a first plane and registered with itself; the motion found and the mirror make one
    improper motion, whose plane is the next guess.

    Returns:
        A point, the unit normal towards the patient's left, the trunk's robust scatter about its own mirror image, and
        the standard uncertainty of the plane's place, mm.
    """
    middles = [measured.boundary_world.mean(axis=0) for measured in measurements]
    point = np.mean(middles, axis=0)
    normal = frame[0]
    points, normals = trunk_skin(surface, [measured.boundary_world for measured in measurements])
    near = np.linalg.norm(points - point, axis=1) < _WINDOW_MM
    points, normals = points[near], normals[near]
    scatter = sigma = np.inf
    for _ in range(_PLANE_ROUNDS):
        turned = normals - 2 * (normals @ normal)[:, None] * normal
        image = mirror(points, point, normal)
        found = register((image, turned), (points, normals), subject="trunk and its mirror image")
        motion, scatter = found.fixed_from_moving, found.scatter_mm
        sigma = found.weakest_mm / 2
        linear = motion.rotation @ (np.eye(3) - 2 * np.outer(normal, normal))
        values, vectors = np.linalg.eigh((linear + linear.T) / 2)
        image = motion.apply(image)
        normal = vectors[:, np.argmin(values)]
        normal = normal if normal @ frame[0] > 0 else -normal
        halfway = (points + image).mean(axis=0) / 2
        point = point + normal * float((halfway - point) @ normal)
        if np.linalg.norm(motion.rotation_vector_rad) < _AT_REST_RAD:
            break
    return point, normal, float(scatter), float(sigma)


def trunk_skin(
    surface: RepairedSurface, boundaries: Sequence[Float64[Array, "_ 3"]]
) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"]]:
    """Visible vertices at least a centimetre outside every boundary, and their normals.

    A vertex lies inside if it is nearer to a boundary's middle than the boundary is in that direction, seen along the
    boundary's normal. Skin that hangs over the boundary is inside too.
    """
    seen = surface.provenance != Provenance.INVENTED
    seen &= np.bincount(surface.mesh.faces.ravel(), minlength=len(seen)) > 0
    if not seen.any():
        seen[:] = True
    for boundary in boundaries:
        seen &= ~_inside(surface.mesh.vertices, boundary)
    return surface.mesh.vertices[seen], surface.mesh.vertex_normals()[seen]


def _inside(points: Float64[Array, "n 3"], boundary: Float64[Array, "b 3"]) -> Bool[Array, " n"]:
    centre = boundary.mean(axis=0)
    _, _, axes = np.linalg.svd(boundary - centre, full_matrices=False)
    flat, outline = (points - centre) @ axes[:2].T, (boundary - centre) @ axes[:2].T
    around = np.arctan2(outline[:, 1], outline[:, 0])
    order = np.argsort(around)
    reach = np.interp(
        np.arctan2(flat[:, 1], flat[:, 0]), around[order], np.linalg.norm(outline, axis=1)[order], period=2 * np.pi
    )
    size = float(np.linalg.norm(outline, axis=1).max())
    before = np.abs((points - centre) @ axes[2]) < 2 * size  # not the back, far behind the breast
    return (np.linalg.norm(flat, axis=1) < reach + _BESIDE_MM) & before


def signed_mm(
    skin: TriangleMesh, other: TriangleMesh, *, asked: Bool[Array, " n"] | None = None
) -> Float64[Array, " n"]:
    """How far each vertex stands out of another, finely triangulated surface, mm; NaN without a counterpart.

    This is the distance to the tangent plane at the nearest vertex. There is no counterpart beyond the other's edge,
    where the way to the nearest place runs along the surface, or further away than 80 mm.

    Args:
        skin: the surface whose vertices are asked for.
        other: the surface that they stand out of.
        asked: which of the vertices are asked for; the others are NaN. None: all.
    """
    asked = np.ones(len(skin.vertices), dtype=bool) if asked is None else asked
    found = np.full(len(skin.vertices), np.nan)
    points = skin.vertices[asked]
    distance, place = cKDTree(other.vertices).query(points, distance_upper_bound=_FARTHEST_MM)
    near = np.isfinite(distance)
    nearest = np.asarray(place)[near]
    away = points[near] - other.vertices[nearest]
    normals = other.vertex_normals()[nearest]
    signed = (away * normals).sum(axis=1)
    along = np.linalg.norm(away - normals * signed[:, None], axis=1)
    values = np.full(len(points), np.nan)
    values[near] = np.where(along <= np.maximum(_FLUSH_MM, _OBLIQUE * np.abs(signed)), signed, np.nan)
    found[asked] = values
    return found


def rms_mm(skin: TriangleMesh, values_mm: Float64[Array, " n"]) -> float:
    """Root mean square of the finite values on vertices, weighted by area."""
    areas = np.linalg.norm(skin.face_vectors(), axis=1)
    weight = np.bincount(skin.faces.ravel(), np.repeat(areas, 3), minlength=len(skin.vertices))
    known = np.isfinite(values_mm)
    return float(np.sqrt((weight * values_mm**2)[known].sum() / np.maximum(weight[known].sum(), 1e-12)))


def _on_solid(measured: VolumeMeasurement, values: Float64[Array, " n"]) -> Float64[Array, " m"]:
    """Values on the skin's vertices, carried to all vertices of the closed solid."""
    result = np.full(len(measured.closed.vertices), np.nan)
    result[measured.closed.vertices_used_by(np.arange(measured.skin_faces))] = values
    return result
