"""A scanner's mesh, checked and converted to a session's surface.

`scan_repair` repairs what is unambiguous. A mesh that is still torn, inconsistently oriented or in pieces is refused:
it must be corrected in the program that made it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry import Array, Bool, Camera, Float64, Rig, Transform
from mammometry.geometry.mesh import TriangleMesh, edge_table, split_edges
from mammometry.geometry.nearest import point_tree
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.breasts import breasts_per_mm, facing_frame
from mammometry.measure.boundary.trace import BANDS_MM, check_beside_holes, edge_loop
from mammometry.measure.scan_front import ahead_by_feet, front_of_body, upper_trunk, with_notice, without_back
from mammometry.measure.scan_repair import RepairedScan
from mammometry.measure.solid.cut import check_whole, inside_curve
from mammometry.measure.trunk.thorax import find_trunk, frame_from_sides, level_axis, orthonormal, seen_skin
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_EDGE_MM = 3.0  # longest edge near a boundary, for cutting; 2 mm changes a volume by 0.1 % at most
_MARGIN_MM = BANDS_MM[-2]  # distance from a boundary up to which edges are refined: all bands but the widest
_FACES_AT_MOST = 4_000_000  # most faces of a refined mesh; chosen for memory
_VIEWER_MM, _EYES_MM = 1500.0, 200.0  # distance and baseline of the viewer's cameras; only directions matter
_VIEWER_PX = 1000  # size and focal length of the viewer's images, which are never rendered
_ONE_SIDED = 0.2
"""Least length of the horizontal mean normal of a mesh that shows one side only. Fronts of bodies have 0.47 or more, a
half tube 0.64. A tube with an opening on one side has at most the opening's share of the skin, 0.13 (a torso's arm)."""
_ROUNDER = 2.0  # least roundness of a torso's front relative to its other sides
_UPRIGHT = np.cos(np.deg2rad(45.0))  # least cosine between the trunk's axis and the file's upright axis
_AXIS_SAMPLES = 20_000  # faces from whose normals the trunk's axis is found; chosen for speed
_ALONG_AXIS = np.cos(np.deg2rad(20.0))  # a front within this angle of an axis is along that axis; not critical
_FRONT_ROUNDS = 4  # iterations of front and frame; bodies turn by less than 0.2° after the second; not critical
_SAME_FRAME = 1 + 2 * np.cos(np.deg2rad(0.2))  # trace of the rotation between frames that count as equal
_SQUARE = 1e-6  # largest cosine of the angle between head and straight ahead
_ON_MESH_MM = 15.0  # largest median distance of a curve on a mesh from its vertices; not critical

Places = Mapping[str, Float64[Array, "_ 3"]]
"""Landmark → its points, mm, world frame."""


class DirectionError(MeasureError):
    """The patient's front cannot be determined from a scan: `--ahead` states it."""

    code = "direction"
    kind = "MeasureError"
    fronts: Mapping[str, Float64[Array, "3 3"]] = MappingProxyType({})
    """Option that names a side ("--ahead z") → frame that it would give: patient's left, head, straight ahead
    (rows)."""


def as_scanned(
    mesh: TriangleMesh, invented: Bool[Array, " n"] | None = None, at_fold: Bool[Array, " n"] | None = None
) -> RepairedSurface:
    """A mesh as a surface whose skin is measured everywhere except in closed holes.

    Args:
        mesh: mm.
        invented: vertices of closed holes. None: there are none.
        at_fold: vertices of closed holes at hidden folds, on which a border may run.

    Raises:
        MeasureError: it is empty, or not an oriented surface.
    """
    check_mesh(mesh)
    n = len(mesh.vertices)
    provenance = np.full(n, Provenance.MEASURED, dtype=np.uint8)
    if invented is not None:
        provenance[invented] = Provenance.INVENTED
    if at_fold is not None:
        provenance[at_fold] = Provenance.BRIDGED
    return RepairedSurface(
        mesh=mesh,
        provenance=provenance,
        sigma_mm=np.full(n, np.nan, dtype=np.float32),
        pair_bits=np.zeros(n, dtype=np.int32),
        pair_names=(),
        convergence=np.zeros(0),
    )


def check_mesh(mesh: TriangleMesh) -> None:
    """Raise a MeasureError unless a mesh is an oriented surface, closed or open."""
    if not len(mesh.faces):
        raise _refused("no triangles", "a triangulated surface", "Export it with its faces")
    directed = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    n = len(mesh.vertices)
    _, count = np.unique(directed.min(axis=1) * n + directed.max(axis=1), return_counts=True)
    if (count > 2).any():
        raise _refused(
            f"{int((count > 2).sum())} edges at which three or more faces meet",
            "a surface with one or two faces at every edge",
            "Repair its non-manifold edges in the program that made it",
        )
    _, same = np.unique(directed[:, 0] * n + directed[:, 1], return_counts=True)
    if (same > 1).any():
        raise _refused(
            f"{int((same > 1).sum())} edges at which neighbouring faces point to opposite sides",
            "faces that all point outwards",
            "Make its normals consistent in the program that made it",
        )


def finer_scan(scan: RepairedScan, curves: Sequence[Float64[Array, "_ 3"]]) -> RepairedScan:
    """A scan with edges short enough for cutting near the curves.

    New vertices come last. A new vertex is invented, or at a hidden fold, if an end of its edge is.
    """
    if not curves:
        return scan
    vertices, faces = scan.mesh.vertices, scan.mesh.faces
    marked = np.stack([scan.invented, scan.at_fold], axis=1)
    low = np.min([curve.min(axis=0) for curve in curves], axis=0) - _MARGIN_MM
    high = np.max([curve.max(axis=0) for curve in curves], axis=0) + _MARGIN_MM
    while len(faces) < _FACES_AT_MOST:
        edges, of_face = edge_table(faces)
        a, b = vertices[edges[:, 0]], vertices[edges[:, 1]]
        near = ((np.maximum(a, b) > low) & (np.minimum(a, b) < high)).all(axis=1)
        split = near & (np.linalg.norm(a - b, axis=1) > _EDGE_MM)
        if not split.any():
            break
        faces = split_edges(faces, of_face, split, len(vertices))
        vertices = np.concatenate([vertices, (a[split] + b[split]) / 2])
        marked = np.concatenate([marked, marked[edges[split]].any(axis=1)])
    return replace(scan, mesh=TriangleMesh(vertices=vertices, faces=faces), invented=marked[:, 0], at_fold=marked[:, 1])


def check_cut(name: str, points_world: Float64[Array, "n 3"], mesh: TriangleMesh) -> None:
    """Raise an error if a boundary does not cut out a complete breast of an open or closed mesh.

    Raises:
        MeasureError: the mesh has a hole inside the curve, or is inside out there.
    """
    part = inside_curve(mesh, edge_loop(name, points_world, mesh))
    check_whole(name, part)
    check_beside_holes(name, points_world, part, mesh)


def viewing_frame(
    surface: RepairedSurface, boundaries: Sequence[Boundary] | Mapping[str, Float64[Array, "_ 3"]], landmarks: Places
) -> Float64[Array, "3 3"]:
    """Patient's left, head and straight ahead (rows), from landmarks or boundaries.

    For a cast, straight ahead is the direction of its projection, and up is as near to the file's y axis as possible.

    Raises:
        MeasureError: neither is sufficient, or they contradict each other.
    """
    curves = (
        dict(boundaries)
        if isinstance(boundaries, Mapping)
        else {boundary.name: boundary.points_world for boundary in boundaries}
    )
    if "model" in curves:
        rim = curves["model"]
        ahead = np.linalg.svd(rim - rim.mean(axis=0), full_matrices=False)[2][2]
        ahead *= 1.0 if (surface.mesh.vertices.mean(axis=0) - rim.mean(axis=0)) @ ahead >= 0 else -1.0
        return orthonormal(np.eye(3)[1 if abs(ahead[1]) < 0.9 else 2], ahead)
    frame = _frame_from_landmarks(landmarks)
    if frame is None and {"left", "right"} <= curves.keys():
        frame = frame_from_sides(curves["left"], curves["right"], seen_skin(surface))
    if frame is None:
        raise MeasureError(
            "mesh",
            found="neither a boundary on each side nor landmarks of one",
            expected="one of them, to distinguish the patient's left from right and head from foot",
            remedy="Give both boundaries, or pick inframammary_fold, medial and lateral of a side in --landmarks",
        )
    middles = [curve.mean(axis=0) for curve in curves.values()]
    if middles and "sternal_notch" in landmarks:
        above = float((landmarks["sternal_notch"][0] - np.mean(middles, axis=0)) @ frame[1])
        if above < 0:
            raise MeasureError(
                "landmark 'sternal_notch'",
                found=f"a point {-above:.0f} mm below the breasts, by their boundaries and names",
                expected="one above them",
                remedy="Swap left and right in the boundaries or the landmarks, or pick the notch again",
            )
    return frame


def frame_from_axes(mesh: TriangleMesh, head: str | None = None, ahead: str | None = None) -> Float64[Array, "3 3"]:
    """Patient's left, head and straight ahead (rows), from axes of the mesh file.

    Args:
        mesh: the torso, mm.
        head: the file's axis towards the head: ``x``, ``-x``, ``y`` … None: ``y``, or ``z`` if ``y`` is straight ahead
            or the trunk's axis is along ``z``.
        ahead: the axis straight ahead. None: the mean normal of an open mesh, rounded to an axis if near; for a mesh
            with skin on all sides, the side with breasts.

    Raises:
        MeasureError: there is no such axis, or both are along one line.
        DirectionError: the mesh does not show its front; it has the frames of the sides that may be it.
    """
    if ahead is not None:
        forward = _axis(ahead, "--ahead")
        up = _axis(head or ("z" if abs(forward[1]) > 0 else "y"), "--head")
        if abs(up @ forward) > _SQUARE:
            raise MeasureError(
                "mesh",
                found="the head and straight ahead along one axis",
                expected="two axes at a right angle",
                remedy="Correct --head or --ahead",
            )
        return orthonormal(up, forward)
    looks = mesh.face_vectors().sum(axis=0) / mesh.area_mm2()
    up = _axis(head or _upright(mesh, looks), "--head")
    level = looks - up * (looks @ up)
    if np.linalg.norm(level) > _ONE_SIDED:
        return orthonormal(up, _along_axis(level / np.linalg.norm(level)))
    found = ahead_by_feet(mesh, up)
    if found is None:
        found = _ahead_by_breasts(mesh, up)
    if found is None:
        stands = int(np.argmax(np.abs(up)))
        sides = [f"{sign}{letter}" for letter in "zyx" if letter != "xyz"[stands] for sign in ("", "-")]
        refusal = DirectionError(
            "mesh",
            found="a mesh with skin on all sides and no clear breasts on one side, if the head is towards "
            f"{'' if up[stands] > 0 else '-'}{'xyz'[stands]}",
            expected="the side that is the patient's front",
            remedy=f"Give the file's axis that points straight ahead: --ahead {', '.join(sides[:-1])} or {sides[-1]}; "
            "and, if it is another one, the axis towards the head: --head",
        )
        refusal.fronts = {f"--ahead {side}": orthonormal(up, _axis(side, "--ahead")) for side in sides}
        raise refusal
    return orthonormal(up, _along_axis(found))


def own_front(scan: RepairedScan, frame: Float64[Array, "3 3"]) -> tuple[RepairedScan, Float64[Array, "3 3"]]:
    """A scan's front, and the body's own frame: patient's left, head, straight ahead (rows).

    They are found iteratively, each from the other, so that the result does not depend on the orientation of the body
    in the file (docs/decisions/0053). The file's frame is used if no trunk is found, or if only the front in that frame
    shows a breast.

    Args:
        scan: a torso or a whole body, mm.
        frame: the same directions, approximately, by the file's axes.
    """
    upper = upper_trunk(scan, frame[1])
    by_axes = without_back(upper, frame)
    front, own = by_axes, frame
    try:
        for _ in range(_FRONT_ROUNDS):
            before, own = own, find_trunk(seen_skin(as_scanned(front.mesh, front.invented, front.at_fold)), own).frame
            front = without_back(upper, own)
            if np.trace(own @ before.T) > _SAME_FRAME:
                break
        own, found = facing_frame(as_scanned(front.mesh, front.invented, front.at_fold), own)
    except MeasureError:
        return with_notice(by_axes, scan), frame
    if not found:
        with suppress(MeasureError):
            if facing_frame(as_scanned(by_axes.mesh, by_axes.invented, by_axes.at_fold), frame)[1]:
                return with_notice(by_axes, scan), frame
    return with_notice(without_back(upper, own), scan), own


def _upright(mesh: TriangleMesh, looks: Float64[Array, 3]) -> str:
    """The file's axis towards the head, by default: y, else z.

    It is z if the skin faces along y, unless the trunk's axis is y: an open tube faces along its axis.
    """
    vectors = mesh.face_vectors()
    area = np.linalg.norm(vectors, axis=1)
    normals = (vectors / np.maximum(area, 1e-12)[:, None])[:: max(1, len(vectors) // _AXIS_SAMPLES)]
    axis, _ = max((level_axis(normals, start) for start in np.eye(3)), key=lambda found: found[1])
    if abs(axis[1]) > _UPRIGHT:
        return "y"
    along_y = np.argmax(np.abs(looks)) == 1 and abs(looks[1]) > _ONE_SIDED
    along_z = abs(axis[2]) > _UPRIGHT and abs(looks[2]) < _ONE_SIDED  # a front that leans far also faces along z
    return "z" if along_y or along_z else "y"


def _ahead_by_breasts(mesh: TriangleMesh, up: Float64[Array, 3]) -> Float64[Array, 3] | None:
    """Straight ahead of a torso with skin on all sides, from its breasts. None if no side is clear.

    Directions across the torso's width are tried before those along it.

    Args:
        mesh: mm.
        up: towards the head.
    """
    level = mesh.vertices - np.outer(mesh.vertices @ up, up)
    across, aside = np.linalg.eigh(np.cov(level.T) + np.outer(up, up) * np.ptp(level) ** 2)[1].T[:2]
    whole = RepairedScan.unchanged(mesh)
    for line in (across, aside):
        worth = []
        for forward in (line, -line):
            frame = orthonormal(up, forward)
            try:
                worth.append(breasts_per_mm(as_scanned(front_of_body(whole, frame).mesh), frame))
            except MeasureError:
                worth.append(0.0)
        if max(worth) > _ROUNDER * min(worth):
            return line if worth[0] > worth[1] else -line
    return None


def _along_axis(direction: Float64[Array, 3]) -> Float64[Array, 3]:
    """The file's axis near a direction, else the direction itself."""
    axis = np.sign(direction) * (np.abs(direction) == np.abs(direction).max())
    return axis if direction @ axis > _ALONG_AXIS else direction


def _axis(name: str, option: str) -> Float64[Array, 3]:
    sign, letter = (-1.0, name[1:]) if name.startswith("-") else (1.0, name.removeprefix("+"))
    if letter not in ("x", "y", "z"):
        raise MeasureError(
            option, found=repr(name), expected="one of x, y, z, -x, -y, -z", remedy="Name an axis of the mesh file"
        )
    return sign * np.eye(3)["xyz".index(letter)]


def in_mesh_unit(points_mm: Float64[Array, "n 3"], mesh: TriangleMesh, mm_per_unit: float) -> Float64[Array, "n 3"]:
    """A drawn curve in mm, from mm or from the mesh file's unit, whichever puts it nearer to the mesh."""
    vertices = point_tree(mesh.vertices)
    as_mm, as_unit = (float(np.median(vertices.query(points_mm * factor)[0])) for factor in (1.0, mm_per_unit))
    return points_mm * mm_per_unit if as_unit < min(_ON_MESH_MM, as_mm) else points_mm


def _frame_from_landmarks(places: Places) -> Float64[Array, "3 3"] | None:
    """Frame from fold, medial and lateral end of the complete sides. None if no side is complete."""
    across, up = np.zeros(3), np.zeros(3)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        needed = [f"{name}_{side}" for name in ("medial", "lateral", "inframammary_fold")]
        if all(name in places for name in needed):
            medial, lateral, fold = (places[name][0] for name in needed)
            across += sign * (lateral - medial)
            up += (medial + lateral) / 2 - fold
    if {"medial_left", "medial_right"} <= places.keys() and across.any():
        across = places["medial_left"][0] - places["medial_right"][0]
    if not across.any():
        return None
    return orthonormal(up, np.cross(across, up))


def viewer(frame: Float64[Array, "3 3"], mesh: TriangleMesh) -> Rig:
    """Rig of two virtual cameras in front of a mesh, level and upright.

    Args:
        frame: patient's left, head, straight ahead (rows).
        mesh: the mesh in view, mm.
    """
    left, up, ahead = frame
    rotation = np.stack([left, -up, -ahead])
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    eyes, middle_px = {}, (_VIEWER_PX - 1) / 2
    for name, sign in (("left", -1.0), ("right", 1.0)):
        centre = middle + _VIEWER_MM * ahead + sign * _EYES_MM / 2 * left
        eyes[name] = Camera(
            name=name,
            size_wh=(_VIEWER_PX, _VIEWER_PX),
            matrix=np.array([[_VIEWER_PX, 0.0, middle_px], [0.0, _VIEWER_PX, middle_px], [0.0, 0.0, 1.0]]),
            distortion=np.zeros(5),
            camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre),
        )
    return Rig(name="viewer", cameras=eyes, pair_names={"view": ("left", "right")})


def _refused(found: str, expected: str, remedy: str) -> MeasureError:
    return MeasureError("mesh", found=found, expected=expected, remedy=remedy)
