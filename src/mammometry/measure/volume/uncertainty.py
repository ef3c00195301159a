"""The 95 % interval of a volume, by source (linear theory).

To first order, a displacement u of the skin changes the volume by ∫ n·u over it. After a motion of cameras or body, u
is its uncertainty (`movement_cc`), minus the rigid motion of the boundary, with which the wall moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.normal import COVERAGE_95
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Int32, Rig, TriangleMesh, mesh_kernels, read_only
from mammometry.geometry.nearest import point_tree
from mammometry.geometry.twist import rigid_motions
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.solid.patch import harmonic_between
from mammometry.measure.volume.boundary_jitter import UNSEEN_SLOPE
from mammometry.measure.volume.sources import (
    AXIS,
    BOUNDARY,
    BOUNDARY_CORRELATION,
    HIDDEN_FOLD,
    MOVEMENT,
    SCALE,
    WALL,
    WALL_CORRELATION,
    WALL_FIT_U95_MM,
)
from mammometry.measure.volume.unseen_space import Bound, outward_room_mm
from mammometry.measure.wall.chest_wall import ChestWall
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS
from mammometry.surface.motion.motion_detection import MotionEstimate
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_SAMPLES = 2000  # vertices of the skin at which displacements are computed; chosen for speed
_ALIKE_MM = 40.0
"""Correlation length of non-rigid motion, mm: breathing lifts whole parts of a chest. Not critical."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureMotion:
    """Motion of cameras or body, and the rig with its corrected cameras."""

    found: MotionEstimate
    rig: Rig
    """The corrected cameras."""


def movement_of(found: MotionEstimate, rig: Rig) -> CaptureMotion | None:
    """Motion between calibration and exposures. None if nothing moved."""
    return CaptureMotion(found=found, rig=rig) if found.moved else None


def movement_cc(
    movement: CaptureMotion, skin: TriangleMesh, boundary_world: Float64[Array, "n 3"], surface: RepairedSurface
) -> tuple[Float64[Array, " p"], float]:
    """Uncertainty of a volume after motions, cc.

    Args:
        movement: motion of the capture.
        skin: the breast's skin, mm, world frame.
        boundary_world: the curve around it, mm.
        surface: the whole repaired surface, with the pairs that measured each vertex.

    Returns:
        Signed change of the volume by one standard deviation of each independent motion, which all volumes of the
        capture share; and the standard deviation by non-rigid motion, which they do not.
    """
    found = movement.found
    area_mm2 = np.zeros(len(skin.vertices))
    for corner in range(3):
        np.add.at(area_mm2, skin.faces[:, corner], np.linalg.norm(skin.face_vectors(), axis=1) / 3)
    some = slice(None, None, max(1, len(skin.vertices) // _SAMPLES))
    points, normals, weights = skin.vertices[some], skin.vertex_normals()[some], area_mm2[some]
    weights = weights * (area_mm2.sum() / weights.sum())
    own, around = (_displacements(movement, array, surface) for array in (points, boundary_world))
    centre = boundary_world.mean(axis=0)
    motion_parameters = around.shape[2]
    rigid = np.linalg.lstsq(
        rigid_motions(boundary_world - centre).reshape(-1, 6), around.reshape(-1, motion_parameters), rcond=None
    )[0]
    own = own - rigid_motions(points - centre) @ rigid
    gradient = np.einsum("n,ni,nip->p", weights, normals, own)
    whole_mm2 = float(area_mm2.sum())
    alike_mm2 = min(np.pi * _ALIKE_MM**2, whole_mm2)
    rest_mm3 = found.rest_mm / np.sqrt(2) * np.sqrt(whole_mm2 * alike_mm2)
    variances, motions = np.linalg.eigh(found.covariance)
    return np.sqrt(np.maximum(variances, 0.0)) * (gradient @ motions) / 1000, float(rest_mm3) / 1000


def _displacements(
    movement: CaptureMotion, points: Float64[Array, "n 3"], surface: RepairedSurface
) -> Float64[Array, "n 3 p"]:
    """Displacement of surface points per unit of each motion parameter, mean of the pairs that saw them."""
    bits = _measured_by(points, surface)
    total = np.zeros((len(points), 3, movement.found.parameters.count))
    count = np.zeros(len(points))
    for number, pair in enumerate(surface.pair_names):
        seen = (bits >> number & 1).astype(bool)
        if seen.any() and any(pair in group for group in movement.found.parameters.groups):
            total[seen] += movement.found.parameters.effects(movement.rig, pair, points[seen]).points_mm
            count[seen] += 1
    shared: Float64[Array, "n 3 p"] = total / np.maximum(count, 1)[:, None, None]
    return shared


def _measured_by(points: Float64[Array, "n 3"], surface: RepairedSurface) -> Int32[Array, " n"]:
    """Bit mask of the pairs that measured the nearest measured vertex."""
    known = np.flatnonzero(surface.pair_bits)
    if not len(known):
        return np.zeros(len(points), dtype=np.int32)
    nearest = np.asarray(point_tree(surface.mesh.vertices[known]).query(points, workers=1)[1])
    return np.asarray(surface.pair_bits[known[nearest]])


COMMON_SHARE = 0.35
"""Share of measured skin's expected error that is common to all of it: with weak texture and noise, matching flattens
convex skin. For casts at 0.15 of full size the mean error was 0.1 to 0.4 of the expected one."""
MATCHING_REACH_MM = 3.0
"""Correlation length of random errors of a matched surface, mm: half a matching window."""
REPAIRED_SIGMA_MM = 0.1
"""Standard uncertainty of repaired skin beside measured skin, along its normal, mm; common to all of it. Errors of
repaired casts: mean 0.08 mm, 99 % below 0.8 mm, of both signs."""
INVENTED_SIGMA_MM = 0.4
"""Standard uncertainty of skin without measurements and measured neighbours, mm; common to all of it."""
_HIDDEN_FOLD_U95_MM = 15.0
"""Half-width of the depth error over completed skin at a hidden fold, mm: twice the root mean square of the difference
between scan and clean mesh, over that skin, of eighteen breasts (docs/decisions/0051)."""
AXIS_U95_SHARE = 0.025
"""Half-width for an assumed depth of the trunk's axis, as a share of the volume: depths of 80 to 170 mm change volumes
by ± 2.5 %."""
WALL_MEASURED_U95_MM = 1.0
"""Half-width for a separately measured wall (wall.ply), mm: how well two scans can be registered."""
_BOUNDARY_CC_PER_MM_CM2 = 0.025
"""Standard deviation of a torso's volume per mm of boundary jitter and cm² of base, cc: 16 cc for 4 mm on bases of
166 cm². Used if the boundary cannot be redrawn."""
_ROOM_SAMPLES = 4000  # unseen vertices whose free space is computed; the others use the nearest one's; for speed


@dataclass(frozen=True, slots=True, kw_only=True)
class EarlierErrors:
    """Errors of the calibration, which are unknown for imported cameras."""

    scale_std: float | None = None
    """Relative standard uncertainty of all lengths, from the measurement of the target."""
    point_std_mm: float | None = None
    """Standard uncertainty of a reconstructed point from the cameras' covariance, root sum of three directions, mm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VolumeEvidence:
    """Results of earlier stages about the errors of a volume, each of which may be unknown."""

    surface: RepairedSurface | None = None
    """Surface with its measured, repaired and invented skin. None: all skin counts as measured."""
    views: Sequence[Bound] = ()
    """Space that views exclude for a cast (`unseen_space.bounds`). They do not bound a patient's folds."""
    earlier: EarlierErrors = EarlierErrors()
    """Errors of the calibration."""
    boundary_std_cc: float | None = None
    """Standard deviation of the volume by boundary jitter (`boundary_jitter`), cc. None: 0.025 cc per mm and cm²."""
    movement: CaptureMotion | None = None
    """Motion between calibration and exposures. None: none or unknown."""
    axis_assumed: bool = False
    """Whether the depth of the trunk's axis is assumed, because its sides are not visible."""


@value
class Uncertainty:
    """A 95 % interval and its contributions."""

    interval_cc: tuple[float, float] | None
    """95 % interval, cc. None if unknown."""
    as_defined_cc: tuple[float, float] | None
    """95 % interval of the volume in front of the named wall, cc. None for a cast, and without an interval."""
    terms_cc: Mapping[str, float]
    """Half-width at 95 % of each source, cc."""
    common_cc: Mapping[str, tuple[float, ...]]
    """Source → signed changes of the volume, cc at 95 %, by errors that all volumes of a capture share
    (`VolumeMeasurement.common_cc`)."""
    note: str
    """What the interval covers and what it does not."""


def interval(
    boundary: Boundary,
    wall: ChestWall,
    volume_cc: float,
    settings: MeasureSettings = MeasureSettings(),
    evidence: VolumeEvidence = VolumeEvidence(),
) -> Uncertainty:
    """Interval of a volume from the known sources, taken as independent (root of the sum of squares).

    To first order, an error e of the surface along its normal over an area A changes the volume by e·A. At 95 %:

    - *scale*: 3·u·V.
    - *calibration*: the expected error of a point along the normal, over the skin.
    - *movement* of cameras or body: its uncertainty after correction (`movement_cc`).
    - *matching*: the bias of windows on convex skin, over the measured skin, and each vertex's own σ over its area.
    - *repaired* and *invented surface*: an error that grows with the distance from measured skin; on a photographed
      cast it is limited to the space that no view excludes. Invented skin in a pit may be wrong by the whole pit.
    - *base* of a cast: scatter of the rim, errors of the silhouettes, and the rounding of the rim.
    - *boundary* of a torso: redrawn (`boundary_jitter`).
    - *chest wall* of a torso: a height over the base, proportional to the base's width.
    - *hidden fold*: a depth over the skin that closes a hole below a hanging breast.
    - *trunk's axis*, if assumed: a share of the volume.

    A torso's interval refers to the volume above a flat chest, which no photograph shows behind the breast. The volume
    in front of the named wall has a smaller error: the wall's term is then only the difference between walls of one
    breast from capture to capture (`WALL_FIT_U95_MM`).

    Args:
        boundary: the curve around the breast.
        wall: the wall that closes it.
        volume_cc: volume between skin and wall, cc.
        settings: standard uncertainties that earlier stages do not provide.
        evidence: results of earlier stages.
    """
    area_cm2 = wall.mesh.area_mm2() / 100
    torso = boundary.name != "model"
    model = (TORSO_WALLS if torso else CAST_WALLS)[wall.kind]
    surface, earlier, boundary_std_cc = evidence.surface, evidence.earlier, evidence.boundary_std_cc
    terms: dict[str, float] = {}
    common: dict[str, tuple[float, ...]] = {}
    missing = []
    if earlier.scale_std is not None:
        terms[SCALE] = COVERAGE_95 * 3 * earlier.scale_std * volume_cc
    else:
        missing.append("the size of the printed board: measure the board to include it")
    if earlier.point_std_mm is not None:
        terms["calibration"] = COVERAGE_95 * earlier.point_std_mm / np.sqrt(3) * wall.skin.area_mm2() / 1000
    elif surface is None or surface.pair_names:
        missing.append("the errors of the imported cameras, which are not known")
    else:
        missing.append("distortions of the scan: its file says nothing about them")
    if evidence.movement is not None and surface is not None:
        shared_cc, own_cc = movement_cc(evidence.movement, wall.skin, boundary.points_world, surface)
        terms[MOVEMENT] = COVERAGE_95 * float(np.hypot(np.linalg.norm(shared_cc), own_cc))
        common[MOVEMENT] = tuple((COVERAGE_95 * shared_cc).tolist())
    of_skin, bias_of_skin = _of_skin(wall.skin, surface, evidence.views, settings)
    terms |= of_skin
    common |= bias_of_skin
    if not (torso or model.measured):
        if boundary.sigma_mm is None:
            return Uncertainty(
                interval_cc=None,
                as_defined_cc=None,
                terms_cc={},
                common_cc={},
                note="There is no interval, because the uncertainty of the boundary is not known.",
            )
        terms["base"] = COVERAGE_95 * boundary.sigma_mm * area_cm2 / 10
    else:
        if torso:
            if boundary_std_cc is None:
                across_mm = np.zeros(1) if boundary.across_mm is None else boundary.across_mm
                sigma_mm = float(np.sqrt(settings.observers.mean_mm**2 + np.mean(across_mm**2)))
                boundary_std_cc = sigma_mm * _BOUNDARY_CC_PER_MM_CM2 * area_cm2
            terms[BOUNDARY] = COVERAGE_95 * boundary_std_cc
            if boundary.across_mm is not None:
                common[BOUNDARY] = (BOUNDARY_CORRELATION**0.5 * terms[BOUNDARY],)
        height_mm = WALL_MEASURED_U95_MM if model.measured else model.off_u95_mm(area_cm2)
        terms[WALL] = height_mm * area_cm2 / 10
        if not model.measured:
            common[WALL] = (WALL_CORRELATION**0.5 * terms[WALL],)
        if boundary.hidden_fold_cm2:
            terms[HIDDEN_FOLD] = _HIDDEN_FOLD_U95_MM * boundary.hidden_fold_cm2 / 10
        if evidence.axis_assumed:
            terms[AXIS] = AXIS_U95_SHARE * volume_cc
    if torso and not model.sees_the_chest:
        missing.append("the error of this wall, which ignores the curve of the chest: the volume is too large")
    terms = {name: float(term) for name, term in terms.items()}
    common |= {name: (terms[name],) for name in (SCALE, AXIS) if name in terms}
    as_defined = None
    if torso:
        fit_cc = min(terms[WALL], WALL_FIT_U95_MM * area_cm2 / 10)
        as_defined = _around(volume_cc, terms | {WALL: fit_cc})
    note = f"The interval covers {_listed(list(terms))}."
    if MOVEMENT in terms:
        note += (
            " Cameras or body moved between the calibration and the photographs: what that leaves unknown makes "
            f"± {terms[MOVEMENT]:.1f} cc of it."
        )
    if AXIS in terms:
        note += (
            " Too little of the trunk's sides was seen: its axis is taken to lie as far behind the breastbone as it "
            f"usually does, which makes ± {terms[AXIS]:.1f} cc of it."
        )
    for omission in missing:
        note += f" It does not cover {omission}."
    return Uncertainty(
        interval_cc=_around(volume_cc, terms), as_defined_cc=as_defined, terms_cc=terms, common_cc=common, note=note
    )


def _around(volume_cc: float, terms_cc: Mapping[str, float]) -> tuple[float, float]:
    half = float(np.linalg.norm(list(terms_cc.values())))
    return max(volume_cc - half, 0.0), volume_cc + half


def _of_skin(
    skin: TriangleMesh, surface: RepairedSurface | None, views: Sequence[Bound], settings: MeasureSettings
) -> tuple[dict[str, float], dict[str, tuple[float, ...]]]:
    """Half-widths at 95 % from measured, repaired and invented skin, and their common parts, cc."""
    own_mm2 = np.zeros(len(skin.vertices))
    face_mm2 = np.linalg.norm(skin.face_vectors(), axis=1)
    for corner in range(3):
        np.add.at(own_mm2, skin.faces[:, corner], face_mm2 / 3)
    if surface is None:
        terms = _at_95({"matching": settings.surface_sigma_mm * own_mm2.sum()})
        return terms, {name: (term,) for name, term in terms.items()}
    nearest = np.asarray(point_tree(surface.mesh.vertices).query(skin.vertices, workers=1)[1])
    origin = surface.provenance[nearest]
    seen, invented = origin == Provenance.MEASURED, origin == Provenance.INVENTED
    repaired = ~(seen | invented)
    sigma_mm = np.nan_to_num(surface.sigma_mm[nearest[seen]].astype(np.float64))
    # Windows overlap: errors of measured vertices are equal within a patch, and beyond it share only a common part.
    patch_mm2 = np.pi * MATCHING_REACH_MM**2
    scatter = np.sqrt(np.sum(sigma_mm**2 * own_mm2[seen] * np.maximum(own_mm2[seen], patch_mm2)))
    common = own_mm2[seen] @ np.hypot(settings.surface_sigma_mm, COMMON_SHARE * sigma_mm)
    possible_mm = UNSEEN_SLOPE * _may_be_off_mm(skin, ~seen, surface, views)
    unseen_mm2 = own_mm2[~seen]

    def unseen(which: Bool[Array, " n"], beside_mm: float) -> float:
        return float(unseen_mm2[which[~seen]] @ np.hypot(beside_mm, possible_mm[which[~seen]]))

    measured = "matching" if surface.pair_names else "scanner"
    terms = _at_95(
        {
            measured: float(np.hypot(common, scatter)),
            "repaired surface": unseen(repaired, REPAIRED_SIGMA_MM),
            "invented surface": float(np.hypot(unseen(invented, INVENTED_SIGMA_MM), _pits_mm3(skin, invented))),
        }
    )
    return terms, {name: (term,) for name, term in _at_95({measured: float(common)}).items()}


def _pits_mm3(skin: TriangleMesh, invented: Bool[Array, " n"]) -> float:
    """Volume of pits in invented skin, behind a harmonic surface from its edge, mm³.

    Skin has no pits: they are carved by views in which something in front, such as a rail, hides the skin.
    """
    held = ~invented
    held[mesh_kernels.open_vertices(len(skin.vertices), skin.faces)] = True
    if held.all() or not held.any():
        return 0.0
    spanned = read_only(harmonic_between(skin.vertices, skin.faces.astype(np.int64), held, skin.vertices[held]))
    middle = skin.vertices.mean(axis=0)
    pits_mm3 = mesh_kernels.volume(spanned, skin.faces, middle) - mesh_kernels.volume(skin.vertices, skin.faces, middle)
    return max(float(pits_mm3), 0.0)


def _at_95(std_mm3: Mapping[str, float]) -> dict[str, float]:
    return {name: COVERAGE_95 * std / 1000 for name, std in std_mm3.items() if std > 0}


def _may_be_off_mm(
    skin: TriangleMesh, which: Bool[Array, " n"], surface: RepairedSurface, views: Sequence[Bound]
) -> Float64[Array, " k"]:
    """Largest error of unmeasured vertices, mm. 0 if nothing was measured.

    It is the distance from measured skin, or the space that no view excludes if that is less.
    """
    measured = surface.mesh.vertices[surface.provenance == Provenance.MEASURED]
    if not (len(measured) and which.any()):
        return np.zeros(np.count_nonzero(which))
    points, normals = skin.vertices[which], skin.vertex_normals()[which]
    away_mm = np.asarray(point_tree(measured).query(points, workers=1)[0])
    some = slice(None, None, max(1, len(points) // _ROOM_SAMPLES))
    room_mm = outward_room_mm(points[some], normals[some], views, away_mm[some])
    like = np.asarray(point_tree(points[some]).query(points)[1])
    return np.minimum(away_mm, room_mm[like])


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
