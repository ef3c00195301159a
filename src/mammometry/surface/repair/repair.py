"""Elastic repair of the first surface to the valid range data (paper 2.6.3)."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from scipy import ndimage

from mammometry.base.errors import SurfaceError
from mammometry.base.machine.cores import map_in_threads
from mammometry.base.progress import Progress, no_progress
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float32, Float64, Int32, TriangleMesh, UInt8, bounds
from mammometry.geometry.nearest import point_tree
from mammometry.surface.ranges.dents import ValidPatches
from mammometry.surface.repair import elastic_kernels
from mammometry.surface.repair.correspond import Correspondences, Gates, ViewData, correspond, view_data
from mammometry.surface.repair.energy import Graph, graph_of_mesh, minimum
from mammometry.surface.repair.untangle import touching, without_crossings, without_flips
from mammometry.surface.settings import RepairSettings

FALSE_WEIGHT = 0.2
"""ω of a vertex without a plausible point, whose target is its neighbours' displacement. With 0 the solution needs many
times the iterations."""
REACH_MM = 4.0
"""Largest distance of a plausible datum from the vertex, mm."""
NORMAL_ANGLE_DEG = 45.0
"""Largest angle between the normals of vertex and plausible datum, degrees."""
TANGENTIAL_MM = 0.8
"""Largest tangential distance of a datum, mm. Beyond it, the vertex is outside the data."""
SIMILARITY_MM = 2.0
"""Distance at which the similarity ω is 1/e, mm."""
REPAIRED_REACH_MM, BRIDGED_REACH_MM = 2.0, 15.0
"""Distance from measured vertices along the surface up to which a vertex without a datum counts as repaired, and as
bridged, mm. Errors: repaired skin 0.7 mm on average, bridged skin millimetres (docs/decisions/0026)."""
_MAX_ITERATIONS = 400  # most iterations of conjugate gradients; about 125 are usual (docs/decisions/0007)
_TOLERANCE = 1e-3  # relative residual at which they stop; 1e-6 changed nothing
_FADED = 10.0  # fading lengths after which a displacement is negligible: e⁻¹⁰


class Provenance(IntEnum):
    """Origin of a vertex. The numbers are stored in mesh.ply and must not change."""

    INVENTED = 0
    """Nothing was measured there: closed smoothly."""
    REPAIRED = 1
    """Without a datum of its own, next to measured skin. Displaced with its neighbours."""
    MEASURED = 2
    """Fitted to range data of at least one pair."""
    BRIDGED = 3
    """Between measured places or beyond their edge, as over folds and in armpits. Not counted as skin."""


@value(eq=False)
class RepairedSurface:
    """The repaired mesh and the origin of each vertex."""

    mesh: TriangleMesh
    """Same faces as the first surface. World frame, mm."""
    provenance: UInt8[Array, " n"]
    """`Provenance` of each vertex."""
    sigma_mm: Float32[Array, " n"]
    """Expected standard deviation of a measured vertex along the normal, mm. NaN if not measured."""
    pair_bits: Int32[Array, " n"]
    """Bit k set: pair `pair_names[k]` measured this vertex."""
    pair_names: tuple[str, ...]
    """The pairs of these bits, in order."""
    convergence: Float64[Array, " rounds"]
    """RMS movement in each round, mm, of the vertices that are near enough to data to move."""
    crossings: int | None = None
    """Pairs of crossing faces found after the repair. None if nothing was repaired."""

    @property
    def claimed(self) -> Bool[Array, " n"]:
        """Vertices that are measured or repaired skin."""
        return np.isin(self.provenance, (Provenance.REPAIRED, Provenance.MEASURED))

    def __post_init__(self) -> None:
        n = len(self.mesh.vertices)
        if not len(self.provenance) == len(self.sigma_mm) == len(self.pair_bits) == n:
            raise ValueError(f"one provenance, sigma and pair set per vertex expected, mesh has {n}")


def repair(
    initial: TriangleMesh,
    valid: ValidPatches,
    settings: RepairSettings = RepairSettings(),
    *,
    progress: Progress = no_progress,
) -> RepairedSurface:
    """Fit the first surface elastically to the valid range data (paper 2.6.3, Eq. 4–6).

    World frame, mm. Faces and topology are those of `initial`. Each round searches for plausible points (TRUE
    vertices), propagates their displacements ring by ring to the other vertices (FALSE), and solves for all. It ends
    after `rounds`, or when a round moves the vertices no less than the one before. (The paper's step 4 repeats its
    steps 2 to 4. Correspondences must be searched again, so ours repeats 1 to 3.) Where the solution would turn a
    triangle over, its vertices get their neighbours' mean displacement. Where faces would cross, they move back towards
    the first surface, which does not cross itself, until none cross. If displacements fade, vertices too far from all
    data to move are left out.

    Raises:
        SurfaceError: no vertex has a plausible point.
    """
    near = _near_data(initial, valid, settings)
    displacement, provenance, found, moves = _drawn_to_data(initial.submesh(near), valid, settings, progress)
    kept = np.zeros(len(initial.vertices), dtype=bool)
    kept[initial.faces[near]] = True
    mesh, crossings = without_crossings(initial, _spread(displacement, kept, 0.0))
    progress(1.0)
    return RepairedSurface(
        mesh=mesh,
        provenance=_spread(provenance, kept, Provenance.INVENTED),
        sigma_mm=_spread(found.sigma_mm, kept, np.nan),
        pair_bits=_spread(found.pair_bits, kept, 0),
        pair_names=tuple(image.name for image in valid.range_images),
        convergence=np.array(moves),
        crossings=crossings,
    )


def _drawn_to_data(
    initial: TriangleMesh, valid: ValidPatches, settings: RepairSettings, progress: Progress
) -> tuple[Float64[Array, "n 3"], UInt8[Array, " n"], Correspondences, list[float]]:
    """Displacements of vertices near data, provenance, correspondences, and RMS moves, mm.

    The other values of this function are large, and freed before the search for crossings.
    """
    graph = graph_of_mesh(initial)
    spacing = float(np.sqrt(2 * np.median(np.linalg.norm(initial.face_vectors(), axis=1))))  # of the fine cubes
    views = map_in_threads(lambda image: view_data(image, spacing, taper_mm=settings.taper_mm), valid.range_images)
    displacement = np.zeros_like(initial.vertices)
    moves: list[float] = []
    progress(0.1)
    found = _correspondences(initial, views, settings)
    if not found.found.any():
        raise SurfaceError(
            f"pairs {', '.join(image.name for image in valid.range_images)}",
            found="no valid range data near the first surface",
            expected="a first surface made from the same range data",
            remedy="Run the surface stage again from the range images",
        )
    rounds = max(settings.rounds, 1)
    for number in range(rounds):
        solved = _solve(initial, found, displacement if moves else None, graph, settings)
        move = float(np.sqrt(np.mean(np.sum((solved - displacement) ** 2, axis=1))))
        progress(0.1 + 0.8 * (number + 1) / rounds)
        if moves and move >= moves[-1]:
            break
        displacement = solved
        moves.append(move)
        if number + 1 < rounds:
            moved = TriangleMesh(vertices=initial.vertices + displacement, faces=initial.faces)
            found = _correspondences(moved, views, settings)
    provenance = np.where(found.found, Provenance.MEASURED, Provenance.REPAIRED).astype(np.uint8)
    _, away_mm = propagate(np.zeros((len(provenance), 1)), found.found, graph, initial.vertices)
    provenance[away_mm > REPAIRED_REACH_MM] = Provenance.BRIDGED
    provenance[away_mm > BRIDGED_REACH_MM] = Provenance.INVENTED
    return displacement, provenance, found, moves


def as_measured(mesh: TriangleMesh, valid: ValidPatches) -> RepairedSurface:
    """An open surface with the provenance of its vertices, which are range data. Nothing is moved."""
    images = valid.range_images
    data = np.concatenate([image.valid_points_world() for image in images])
    sigma_mm = np.concatenate([image.sigma_mm[image.valid] for image in images])
    bits = np.concatenate([np.full(int(image.valid.sum()), 1 << k, np.int32) for k, image in enumerate(images)])
    _, nearest = point_tree(data).query(mesh.vertices)
    return RepairedSurface(
        mesh=mesh,
        provenance=np.full(len(mesh.vertices), Provenance.MEASURED, dtype=np.uint8),
        sigma_mm=sigma_mm[nearest],
        pair_bits=bits[nearest],
        pair_names=tuple(image.name for image in images),
        convergence=np.zeros(0),
    )


def _near_data(mesh: TriangleMesh, valid: ValidPatches, settings: RepairSettings) -> Bool[Array, " m"]:
    """Faces near enough to data to move or count as repaired. All faces if displacements do not fade."""
    if settings.fade_mm == 0:
        return np.ones(len(mesh.faces), dtype=bool)
    reach_mm = REACH_MM + max(BRIDGED_REACH_MM, _FADED * settings.fade_mm)
    cell_mm = REACH_MM  # coarse, for speed only
    low, high = bounds(mesh.vertices)
    low -= REACH_MM
    cell = ((mesh.vertices - low) / cell_mm).astype(np.int32)
    empty = np.ones(((high - low) / cell_mm).astype(np.int32) + 2, dtype=bool)
    for image in valid.range_images:
        of_data = np.floor((image.valid_points_world() - low) / cell_mm).astype(np.int64)
        empty[tuple(of_data[((of_data >= 0) & (of_data < empty.shape)).all(axis=1)].T)] = False
    if empty.all():
        return np.ones(len(mesh.faces), dtype=bool)
    # Centres of cells are up to a cell's diagonal farther apart than points in them.
    close = ndimage.distance_transform_edt(empty) * cell_mm <= reach_mm + np.sqrt(3) * cell_mm
    return touching(np.asarray(close[tuple(cell.T)]), mesh.faces)


def _spread(values: Array, kept: Bool[Array, " n"], otherwise: float) -> Array:
    """Values of all vertices from those of the kept ones. The others get the value `otherwise`."""
    result = np.full((len(kept), *values.shape[1:]), otherwise, dtype=values.dtype)
    result[kept] = values
    return result


def _solve(
    initial: TriangleMesh,
    found: Correspondences,
    displacement: Float64[Array, "n 3"] | None,
    graph: Graph,
    settings: RepairSettings,
) -> Float64[Array, "n 3"]:
    """Displacements after one round: propagation to FALSE vertices, then the minimum of Eq. 4."""
    targets, away_mm = propagate(found.targets - initial.vertices, found.found, graph, initial.vertices)
    if settings.fade_mm > 0:
        targets *= np.exp(-away_mm / settings.fade_mm)[:, None]
    weights = np.where(found.found, found.similarity, FALSE_WEIGHT)
    solved, _ = minimum(
        targets,
        weights,
        graph,
        settings.rho,
        start=targets if displacement is None else displacement,
        tolerance=_TOLERANCE,
        max_iterations=_MAX_ITERATIONS,
    )
    return without_flips(initial, solved, graph)


def propagate(
    displacements: Float64[Array, "n k"], known: Bool[Array, " n"], graph: Graph, vertices: Float64[Array, "n 3"]
) -> tuple[Float64[Array, "n k"], Float64[Array, " n"]]:
    """Propagate displacements ring by ring from TRUE to FALSE vertices (paper 2.6.3, step 2).

    A FALSE vertex next to TRUE ones gets their mean and is TRUE for the next ring.

    Returns:
        The displacements, and each vertex's distance from the known ones along the edges, mm: 0 for those. Vertices
        that no ring reaches do not move; their distance is infinite.
    """
    values = np.where(known[:, None], displacements, 0.0)
    away_mm = np.where(known, 0.0, np.inf)
    elastic_kernels.propagate(graph.indptr, graph.indices, vertices, values, away_mm, np.flatnonzero(known))
    return values, away_mm


def _correspondences(mesh: TriangleMesh, views: list[ViewData | None], settings: RepairSettings) -> Correspondences:
    gates = Gates(
        reach_mm=REACH_MM,
        normal_angle_deg=NORMAL_ANGLE_DEG,
        tangential_mm=TANGENTIAL_MM,
        similarity_mm=SIMILARITY_MM,
        blend=settings.target == "blend",
    )
    return correspond(mesh.vertices, mesh.vertex_normals(), views, gates)
