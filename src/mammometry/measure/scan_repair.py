"""Repair of a scan's mesh where the result is unambiguous, with notices of the changes.

Touching seams are joined, small fragments removed, faces turned outwards, small holes closed. Skin in a closed hole is
marked as invented, so that it widens a volume's interval. All other faults are refused by `scanned.check_mesh`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mammometry.base.errors import MeasureError
from mammometry.base.notices import Notice
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Int32, Int64, mesh_kernels
from mammometry.geometry.mesh import TriangleMesh, edge_table, split_edges
from mammometry.geometry.nearest import point_tree
from mammometry.measure.fold_patch import Filling, fold_patch
from mammometry.measure.scan_planes import planar_faces
from mammometry.measure.solid.cut import opening_loops
from mammometry.measure.solid.patch import fill, harmonic

TOUCHING_MM = 0.05
"""Largest distance between open edges of one seam, mm: half of the coarsest step of coordinates."""
WIDEST_HOLE_MM = 90.0
"""Largest width of a hole that is closed (diameter of a circle of its area), mm. Cut necks and arms have 90 or more."""
_FOLD_MM = (48.0, 130.0)
"""Least and largest width of a hole at a hidden fold, mm. The least has 18 cm² (`boundary.hidden_fold`); virtual women
of up to 1,500 cc have up to 107 mm."""
_OWN_EDGE_MM = 70.0  # a longest opening wider than this is the edge of the surface (of a small cast)
_LONGEST_HOLE_MM = 150.0  # longest slit that is closed; not critical
_CRUMB = 0.01  # share of the area below which a piece is a small fragment
_BESIDE = 0.2  # largest share of the area in pieces other than the body; not critical
_FLAT_MM, _WIDE_MM = 12.0, 80.0  # largest SD across a wall, and least along it; a trunk's front has 40 across
_FEW_FINS = 0.01  # largest share of faces that are removed at edges where three or more meet; not critical
_RING_MM = 12.0  # width of the ring of skin that determines a hole's curvature; not critical
_RING_POINTS = 300  # most points of that ring; chosen for speed
_SMOOTHING = 30.0  # smoothing of the thin plate, mm²: follows a tip, but not 1 mm of noise; not critical
_FEWEST_FACES = 50  # fewest faces of a scan: a dome of 40 faces has four fifths of the true volume
_FEWEST = 10  # fewest points for a plate
_NOTED_MM2 = 5.0  # least area of invented skin that is reported
_NO_AREA_MM2 = 1e-6  # area below which a hole is a seam
_GRID_MM = 2.0  # spacing of vertices in a closed hole: finer than the edges of `scanned.finer_along`


@value(eq=False)
class RepairedScan:
    """A scan's mesh after its repair."""

    mesh: TriangleMesh
    """mm. Vertices of closed holes come last."""
    invented: Bool[Array, " n"]
    """Vertices of closed holes."""
    at_fold: Bool[Array, " n"]
    """Vertices of closed holes at hidden folds, where the surrounding skin is continued (`fold_patch`)."""
    notices: tuple[Notice, ...]
    """What was changed."""
    inside_out: bool = False
    """Whether most of its faces pointed inwards, as in a mirror image."""

    @classmethod
    def unchanged(cls, mesh: TriangleMesh) -> RepairedScan:
        """Result for a mesh without any repair."""
        none = np.zeros(len(mesh.vertices), dtype=bool)
        return cls(mesh=mesh, invented=none, at_fold=none, notices=())


def repair_scan(
    mesh: TriangleMesh, *, largest: bool = False, skin_alone: bool = False, holes: bool = True
) -> RepairedScan:
    """A scan with joined seams, no small fragments, faces outwards and small holes closed.

    Args:
        mesh: the mesh of the file, mm, with coincident vertices merged.
        largest: whether to keep only the largest piece, however large the others are.
        skin_alone: whether to remove planes, which are lids made by another program.
        holes: whether to close small holes.

    Raises:
        MeasureError: it has too few triangles, or several pieces that may be the body.
    """
    if len(mesh.faces) < _FEWEST_FACES:
        raise MeasureError(
            "mesh",
            found=f"{len(mesh.faces) or 'no'} triangle{'s' if len(mesh.faces) != 1 else ''}",
            expected=f"the surface of a body or a cast, with at least {_FEWEST_FACES} triangles",
            remedy="Export the whole scan with its faces",
        )
    notices: list[Notice] = []
    mesh = _without_doubles(mesh)
    mesh = _without_fins(_joined(mesh, notices))
    mesh = _body(mesh, notices, largest=largest)
    turned = _facing_out(mesh, notices)
    if turned is None:  # `scanned.check_mesh` reports the fault
        return replace(RepairedScan.unchanged(mesh), notices=tuple(notices))
    out, inside_out = turned
    if skin_alone:
        out = _without_lids(out, notices)
    mesh = _without_loose_triangles(out)
    scan = _filled(mesh, notices) if holes else RepairedScan.unchanged(mesh)
    return replace(scan, notices=tuple(notices), inside_out=inside_out)


def largest_part(mesh: TriangleMesh) -> TriangleMesh:
    """Connected part with the largest area."""
    areas, part = _areas_mm2(mesh)
    return mesh.submesh(part == np.argmax(areas))


def _areas_mm2(mesh: TriangleMesh) -> tuple[Float64[Array, " p"], Int32[Array, " m"]]:
    """Area of each connected part, and each face's part."""
    count, label = mesh.components()
    part = label[mesh.faces[:, 0]]
    return np.bincount(part, np.linalg.norm(mesh.face_vectors(), axis=1), minlength=count), part


def _without_doubles(mesh: TriangleMesh) -> TriangleMesh:
    """Remove faces with the same corners as an earlier one: some programs write both sides."""
    _, first = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_index=True)
    return mesh if len(first) == len(mesh.faces) else mesh.submesh(np.sort(first))


def _joined(mesh: TriangleMesh, notices: list[Notice]) -> TriangleMesh:
    """Join coincident open edges."""
    before = mesh.components()[0]
    joined = _merged(_split_at_neighbours(mesh))
    after = joined.components()[0]
    if after < before:
        notices.append(Notice(code="mesh-seams-joined", level="note", values={"pieces": before}))
    return joined


def _without_fins(mesh: TriangleMesh) -> TriangleMesh:
    """Remove faces at edges where three or more meet, if they are few. The holes are closed later."""
    rings = mesh_kernels.edge_rings(len(mesh.vertices), mesh.faces)
    crowded = rings[rings] != np.arange(len(rings))
    if not crowded.any():
        return mesh
    left = mesh.submesh(~crowded.reshape(-1, 3).any(axis=1))
    return left if len(left.faces) >= (1 - _FEW_FINS) * len(mesh.faces) else mesh


def _without_lids(mesh: TriangleMesh, notices: list[Notice]) -> TriangleMesh:
    """Remove flat lids if the rest is most of the mesh."""
    planar = planar_faces(mesh)
    if not planar.any() or planar.all():
        return mesh
    skin = largest_part(mesh.submesh(~planar))
    lids_mm2, whole_mm2 = mesh.submesh(planar).area_mm2(), mesh.area_mm2()
    if skin.area_mm2() < (1 - _BESIDE) * (whole_mm2 - lids_mm2):
        return mesh
    notices.append(Notice(code="mesh-lids-removed", level="note", values={"cm2": lids_mm2 / 100}))
    return skin


def _without_loose_triangles(mesh: TriangleMesh) -> TriangleMesh:
    """Remove triangles that are attached by a corner only: closing them as holes would double them."""
    rings = mesh_kernels.edge_rings(len(mesh.vertices), mesh.faces)
    loose = (rings == np.arange(len(rings))).reshape(-1, 3).all(axis=1)
    return mesh.submesh(~loose) if loose.any() and not loose.all() else mesh


def _open_sides(mesh: TriangleMesh) -> Int64[Array, " s"]:
    """Open sides of faces. Side 3 f + k runs from corner k of face f to the next."""
    rings = mesh_kernels.edge_rings(len(mesh.vertices), mesh.faces)
    return np.flatnonzero(rings == np.arange(len(rings)))


def _split_at_neighbours(mesh: TriangleMesh) -> TriangleMesh:
    """Split open sides at vertices of other open sides that are on them."""
    sides = _open_sides(mesh)
    if not len(sides):
        return mesh
    starts, stops = mesh.faces.ravel()[sides], mesh.faces[:, [1, 2, 0]].ravel()[sides]
    rim = np.unique(np.concatenate([starts, stops]))
    a, step = mesh.vertices[starts], mesh.vertices[stops] - mesh.vertices[starts]
    length = np.linalg.norm(step, axis=1)
    near = point_tree(mesh.vertices[rim]).query_ball_point(a + step / 2, length / 2 + TOUCHING_MM)
    inserted: dict[int, list[list[int]]] = {}
    for side, start, direction, long, candidates in zip(sides.tolist(), a, step, length, near, strict=True):
        if len(candidates) <= 2:
            continue
        other = rim[candidates]
        along = (mesh.vertices[other] - start) @ direction / long
        off = np.linalg.norm(mesh.vertices[other] - start - along[:, None] * direction / long, axis=1)
        on = (along > TOUCHING_MM) & (along < long - TOUCHING_MM) & (off <= TOUCHING_MM)
        on &= ~np.isin(other, mesh.faces[side // 3])  # a sliver's own corner
        if on.any():
            corners = other[on][np.argsort(along[on])].tolist()
            inserted.setdefault(side // 3, [[], [], []])[side % 3] = corners
    if not inserted:
        return mesh
    middles: list[Float64[Array, 3]] = []
    fans: list[list[int]] = []
    for face, between in inserted.items():
        corners = mesh.faces[face].tolist()
        around = [vertex for k in range(3) for vertex in (corners[k], *between[k])]
        middle = len(mesh.vertices) + len(middles)
        middles.append(mesh.vertices[corners].mean(axis=0))
        fans += [[middle, around[k - 1], around[k]] for k in range(len(around))]
    whole = np.delete(mesh.faces, list(inserted), axis=0)
    return TriangleMesh(
        vertices=np.concatenate([mesh.vertices, middles]), faces=np.concatenate([whole, np.array(fans, dtype=np.int32)])
    )


def _merged(mesh: TriangleMesh) -> TriangleMesh:
    """Merge touching vertices of open sides."""
    sides = _open_sides(mesh)
    rim = np.unique(np.concatenate([mesh.faces.ravel()[sides], mesh.faces[:, [1, 2, 0]].ravel()[sides]]))
    pairs = point_tree(mesh.vertices[rim]).query_pairs(TOUCHING_MM, output_type="ndarray") if len(rim) else rim
    if not len(pairs):
        return mesh
    number = np.arange(len(mesh.vertices))
    graph = coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(rim), len(rim)))
    _, group = connected_components(graph, directed=False)
    first = np.full(group.max() + 1, len(mesh.vertices))
    np.minimum.at(first, group, rim)
    number[rim] = first[group]
    faces = number[mesh.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    merged = TriangleMesh(vertices=mesh.vertices, faces=faces[whole].astype(np.int32))
    return merged.submesh(np.arange(len(merged.faces)))


def _body(mesh: TriangleMesh, notices: list[Notice], *, largest: bool) -> TriangleMesh:
    """Remove all pieces but the body. Raise a MeasureError if others are too large."""
    areas, part = _areas_mm2(mesh)
    if len(areas) == 1:
        return mesh
    total = areas.sum()
    flat = [bool(area > _CRUMB * total) and _is_flat(mesh.submesh(part == k)) for k, area in enumerate(areas)]
    areas = np.where(flat, 0.0, areas) if not (largest or all(flat)) else areas
    crumbs = (areas < _CRUMB * areas.sum()).sum() == len(areas) - 1
    if not (largest or crumbs or 1 - areas.max() / areas.sum() <= _BESIDE):
        others = np.sort(areas)[::-1][:3] / areas.sum()
        raise MeasureError(
            "mesh",
            found=f"{len(areas)} separate pieces, the largest with {', '.join(f'{other:.0%}' for other in others)} "
            "of the area",
            expected="one connected surface, with at most a few small fragments",
            remedy="Delete the others in the program that made it, or measure only the largest with --largest",
        )
    values = {"pieces": len(areas) - 1, "percent": 100 * float(1 - areas.max() / total)}
    code = "mesh-planes-removed" if any(flat) else "mesh-pieces-removed"
    notices.append(Notice(code=code, level="note", values=values))
    return mesh.submesh(part == np.argmax(areas))


def _is_flat(mesh: TriangleMesh) -> bool:
    """Whether a piece is part of a wall, a floor or a table: wide and planar."""
    area = np.linalg.norm(mesh.face_vectors(), axis=1)
    variance = np.linalg.eigvalsh(np.cov(mesh.corners().mean(axis=1).T, aweights=area))
    return bool(variance[0] < _FLAT_MM**2 and variance[1] > _WIDE_MM**2)


def _facing_out(mesh: TriangleMesh, notices: list[Notice]) -> tuple[TriangleMesh, bool] | None:
    """The mesh with all faces outwards, and whether most of its area pointed inwards.

    None if more than two faces meet at an edge, or the surface is not orientable.
    """
    rings = mesh_kernels.edge_rings(len(mesh.vertices), mesh.faces)
    side = np.arange(len(rings))
    if not (rings[rings] == side).all():
        return None
    paired = side[rings > side]
    starts = mesh.faces.ravel()
    unlike = starts[paired] == starts[rings[paired]]  # both faces have the same direction along the edge
    faces, turned_mm2, whole_mm2 = mesh.faces, 0.0, mesh.area_mm2()
    if unlike.any():
        turned = _turned_apart(len(faces), paired // 3, rings[paired].astype(np.int64) // 3, unlike)
        if turned is None:
            return None
        turned_mm2 = mesh.submesh(turned).area_mm2()
        faces = np.where(turned[:, None], faces[:, ::-1], faces)
        mesh = TriangleMesh(vertices=mesh.vertices, faces=np.ascontiguousarray(faces))
    if _stands_out_mm3(mesh) < 0:
        mesh, turned_mm2 = mesh.turned_over(), whole_mm2 - turned_mm2
    inside_out = turned_mm2 > whole_mm2 / 2
    if inside_out:
        notices.append(Notice(code="mesh-inside-out", level="note"))
    elif unlike.any():
        notices.append(Notice(code="mesh-faces-turned", level="note"))
    return mesh, inside_out


def _turned_apart(
    count: int, one: Int64[Array, " e"], other: Int64[Array, " e"], unlike: Bool[Array, " e"]
) -> Bool[Array, " m"] | None:
    """Faces to turn so that neighbours agree. None if that is impossible.

    A graph has two nodes for each face: unchanged and turned. Neighbours that disagree are connected crosswise.
    """
    cross = np.where(unlike, count, 0)
    starts = np.concatenate([one, one + count])
    stops = np.concatenate([other + cross, other + count - cross])
    graph = coo_matrix((np.ones(len(starts), dtype=np.int8), (starts, stops)), shape=(2 * count, 2 * count))
    _, part = connected_components(graph, directed=False)
    as_is, turned = part[:count], part[count:]
    return None if (as_is == turned).any() else np.asarray(turned < as_is)


def _stands_out_mm3(mesh: TriangleMesh) -> float:
    """Volume of a mesh, with openings closed by cones, mm³. Negative: inside out."""
    loops = opening_loops(mesh.faces.astype(np.int64), len(mesh.vertices))
    volume = mesh.volume_mm3()
    middle = mesh.vertices.mean(axis=0)
    for loop in loops:
        points = mesh.vertices[loop] - middle
        volume -= float(np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0) @ points.mean(axis=0)) / 6
    return volume


def _filled(mesh: TriangleMesh, notices: list[Notice]) -> RepairedScan:
    """Close holes up to `WIDEST_HOLE_MM` wide, at hidden folds up to `_FOLD_MM`."""
    loops = opening_loops(mesh.faces.astype(np.int64), len(mesh.vertices))
    closed: dict[int, Filling | None] = {}
    for number, loop in enumerate(loops):  # the longest first
        width_mm = _width_mm(mesh.vertices[loop])
        may_be_fold = number > 0 and _FOLD_MM[0] <= width_mm <= _FOLD_MM[1]
        patch = fold_patch(mesh, loop) if may_be_fold else None
        if patch is not None or width_mm <= (WIDEST_HOLE_MM if number else _OWN_EDGE_MM):
            closed[number] = patch
    holes = [loops[k] for k in closed]
    if not holes:
        return RepairedScan.unchanged(mesh)
    edges = mesh.edges()
    taken = set((edges[:, 0] * len(mesh.vertices) + edges[:, 1]).tolist())
    patches, at_fold = [], [np.zeros(len(mesh.vertices), dtype=bool)]
    for k, patch in closed.items():
        loop = loops[k]
        points, triangles = _without_chords(mesh, loop, *(patch or _patch(mesh, loop, holes)), taken)
        patches.append((loop, points, triangles))
        at_fold.append(np.full(len(points), patch is not None))
    vertices, faces = [mesh.vertices], [mesh.faces]
    count, widest_mm = len(mesh.vertices), 0.0
    for loop, points, triangles in patches:
        indices = np.concatenate([loop, count + np.arange(len(points))])
        faces.append(indices[triangles].astype(np.int32))
        vertices.append(points)
        count += len(points)
        widest_mm = max(widest_mm, _width_mm(mesh.vertices[loop]))
    filled = TriangleMesh(vertices=np.concatenate(vertices), faces=np.concatenate(faces))
    invented = np.arange(count) >= len(mesh.vertices)
    invented_mm2 = filled.area_mm2() - mesh.area_mm2()
    if invented_mm2 > _NOTED_MM2:
        values = {"holes": len(patches), "mm": widest_mm, "cm2": invented_mm2 / 100}
        notices.append(Notice(code="mesh-holes-closed", level="note", values=values))
    return RepairedScan(mesh=filled, invented=invented, at_fold=np.concatenate(at_fold), notices=())


def _fan(count: int) -> Int64[Array, "m 3"]:
    """Triangles from the `count` corners of a hole's edge to its centre."""
    number = np.arange(count)
    return np.stack([np.roll(number, -1), number, np.full(count, count)], axis=1)


def _without_chords(
    mesh: TriangleMesh,
    loop: Int64[Array, " n"],
    points: Float64[Array, "k 3"],
    triangles: Int64[Array, "m 3"],
    taken: set[int],
) -> tuple[Float64[Array, "j 3"], Int64[Array, "i 3"]]:
    """Points and triangles of a hole's patch, with edges split if the mesh already has them.

    Args:
        mesh: the skin with the hole.
        loop: the hole's edge.
        points: points of the patch, without its edge, mm.
        triangles: indices into the edge's corners, then the points.
        taken: edges of the mesh (smaller vertex times number of vertices, plus larger); those of the patch are added.
    """
    faces, corners = triangles.astype(np.int32), np.concatenate([mesh.vertices[loop], points])
    edges, of_face = edge_table(faces)
    across = np.flatnonzero((edges < len(loop)).all(axis=1))
    across = across[~np.isin(np.diff(edges[across])[:, 0], (1, len(loop) - 1))]
    ends = np.sort(loop[edges[across]], axis=1)
    keys = (ends[:, 0] * len(mesh.vertices) + ends[:, 1]).tolist()
    split = np.zeros(len(edges), dtype=bool)
    split[across] = [key in taken for key in keys]
    taken.update(keys)
    middles = corners[edges[split]].mean(axis=1)
    return np.concatenate([points, middles]), split_edges(faces, of_face, split, len(corners)).astype(np.int64)


def _width_mm(rim: Float64[Array, "n 3"]) -> float:
    """Width of a hole, mm. Infinite if it is too long."""
    if np.ptp(rim, axis=0).max() > _LONGEST_HOLE_MM:
        return float("inf")
    after = np.roll(rim, -1, axis=0)
    area = np.linalg.norm(np.cross(rim - rim.mean(axis=0), after - rim.mean(axis=0)).sum(axis=0)) / 2
    return float(np.sqrt(4 * area / np.pi))


def _patch(
    mesh: TriangleMesh, loop: Int64[Array, " n"], holes: Sequence[Int64[Array, " _"]]
) -> tuple[Float64[Array, "k 3"], Int64[Array, "m 3"]]:
    """Points and triangles that close a hole with a thin plate fitted to the skin around it."""
    rim = mesh.vertices[loop]
    middle = rim.mean(axis=0)
    fan = _fan(len(loop))
    outwards = np.cross(np.roll(rim, -1, axis=0) - middle, rim - middle).sum(axis=0)
    if np.linalg.norm(outwards) < _NO_AREA_MM2:
        return middle[None], fan
    ahead = outwards / np.linalg.norm(outwards)
    right = np.cross(np.eye(3)[np.argmin(np.abs(ahead))], ahead)
    right /= np.linalg.norm(right)
    frame = np.stack([right, np.cross(ahead, right), ahead])
    flat = (rim - middle) @ frame.T
    reach = float(np.linalg.norm(flat[:, :2], axis=1).max()) + _RING_MM
    near = np.setdiff1d(mesh.vertices_between(middle - reach, middle + reach), np.concatenate(holes))
    near = near[np.asarray(point_tree(rim).query(mesh.vertices[near])[0]) < _RING_MM]
    local = (mesh.vertices[near] - middle) @ frame.T
    local = np.concatenate([flat, local[:: max(1, len(local) // _RING_POINTS)]])
    local = local[np.unique(np.round(local[:, :2], 3), axis=0, return_index=True)[1]]
    if len(local) < _FEWEST:
        return middle[None], fan
    plate = RBFInterpolator(local[:, :2], local[:, 2], kernel="thin_plate_spline", smoothing=_SMOOTHING)
    patch = fill([flat[::-1, :2]], _GRID_MM)
    smooth = plate(patch.points)
    beside = flat[::-1, 2] - smooth[: patch.n_loop]
    heights = (smooth + harmonic(patch, beside[:, None])[:, 0])[patch.n_loop :]
    inner = np.concatenate([patch.points[patch.n_loop :], heights[:, None]], axis=1)
    triangles = np.where(patch.faces < len(loop), len(loop) - 1 - patch.faces, patch.faces)
    return middle + inner @ frame, triangles
