"""Write a complete session of a virtual rig: manifest, photographs and truth.

The folder has the documented format of a real rig's session, and also ``truth/``, which only ``mammometry evaluate``
reads. The same arguments give the same bytes with any number of threads.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from mammometry.base.errors import SessionError, StorageError
from mammometry.base.new_folder import require_new, whole_folder
from mammometry.base.progress import Progress, no_progress, part
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Rig, Transform
from mammometry.simulate.disturbances.about import Surroundings
from mammometry.simulate.disturbances.exposure import CaptureConditions, plain_exposure
from mammometry.simulate.disturbances.registry import DISTURBANCES, check, disturbed
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering.scene import StudioScene
from mammometry.simulate.rigs.build import build_rig, flashes, pairs_of
from mammometry.simulate.rigs.poses import draw_poses
from mammometry.simulate.rigs.rig_file import find_plan
from mammometry.simulate.rigs.targets import described, sees_target
from mammometry.simulate.studio import Arrangement, Studio, photograph, refusing
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import SubjectSolid, rig_from_solid
from mammometry.simulate.truth import write_truth

_POSES_ENOUGH = 5
"""Number of poses from which on each camera must see the target at least once. Quick previews have fewer."""
_PICTURES_SHARE, _DEPTHS_SHARE = 0.93, 0.99
"""Values of the progress bar after the pictures, and after the depth maps, roughly proportional to time."""
_SHARP_RIM = """\
rim_radius_mm = 0.0   # the mesh ends in a sharp edge; measure a real cast with a radius gauge
"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedSession:
    """The written session and its truth."""

    folder: Path
    rig: Rig
    """The true cameras, rig frame."""
    rig_from_board: Mapping[str, Transform]
    """Pose → rig from board. The board in the first pose is the world frame of the results."""
    scene: StudioScene
    """The scene with the subject, rig frame."""
    true_volumes_cc: Mapping[str, float]
    """Name (``model``, or ``left`` and ``right``) → exact volume, cc. Empty if the subject's mesh is open."""


def write_session(
    out: Path,
    recipe: SessionRecipe = SessionRecipe(),
    studio: Studio = Studio(),
    *,
    subject: SubjectSolid | None = None,
    truth: bool = True,
    progress: Progress = no_progress,
) -> SimulatedSession:
    """Render a virtual rig's session with its truth into a new folder.

    Everything is written to a temporary folder next to `out`, which is renamed at the end, so `out` is complete or
    missing.

    Args:
        out: session folder to create. It must not exist, or must be empty.
        recipe: rig, subject, scale, seed and poses.
        studio: the calibration target, and how pictures are taken.
        subject: photographed instead of the recipe's subject. None: the recipe's.
        truth: whether to write ``truth/``, which takes as long as some pictures.
        progress: called with the fraction of the pictures that are written.

    Raises:
        SessionError: `out` is not empty, or an argument is unknown.
        StorageError: the disk is full or read-only.
    """
    require_new(out)
    seed = recipe.seed
    with refusing(
        SessionError,
        expected="a rig, a subject, a scale and poses that can be rendered",
        remedy="Correct the argument; --help names the choices",
    ):
        check(recipe.situation, without="walk")
        plan, wanted = find_plan(recipe.rig)
        built = build_rig(plan, recipe.scale, seed)
        built = pairs_of(built, wanted) if wanted else built
        lights, situation = flashes(plan=plan), recipe.situation
        exposure: CaptureConditions = disturbed(plain_exposure(built, lights, studio.film), "shoot", situation, seed)
        true_rig = exposure.rig
        studio = replace(studio, skin=disturbed(studio.skin, "skin", situation, seed))
        solid = subject or _subject(recipe)
        rig_from_board = draw_poses(true_rig, studio.target, recipe.poses, seed)
    _check_cameras_see_target(true_rig, studio.target, rig_from_board)
    if plan.lean_rad is not None:
        solid = replace(solid, lean_rad=plan.lean_rad)
    placed = rig_from_solid(solid, seed)
    about = Surroundings(solid=solid, rig_from_solid=placed, skin=studio.skin)
    arrangement = Arrangement(
        exposure=exposure,
        lights=lights,
        rig_from_target=rig_from_board,
        solid=solid,
        rig_from_solid=placed,
        things=disturbed(about, "thing", situation, seed).things,
    )
    try:
        with whole_folder(out) as made:
            scene = photograph(made, arrangement, studio, seed=seed, progress=part(progress, 0.0, _PICTURES_SHARE))
            (made / "session.toml").write_text(_manifest(true_rig, studio.target, solid, recipe.line), encoding="utf-8")
            if truth:
                depths = part(progress, _PICTURES_SHARE, _DEPTHS_SHARE)
                write_truth(made / "truth", arrangement, scene, studio, recipe, progress=depths)
    except OSError as error:
        raise StorageError(
            str(out),
            found=error.strerror or str(error),
            expected="a folder that can be written, with room for the pictures",
            remedy="Free some space or choose another place",
        ) from None
    progress(1.0)
    return SimulatedSession(
        folder=out,
        rig=true_rig,
        rig_from_board=MappingProxyType(dict(rig_from_board)),
        scene=scene,
        true_volumes_cc=MappingProxyType(solid.placed(arrangement.rig_from_solid).volumes_cc),
    )


def true_volumes_cc(recipe: SessionRecipe) -> dict[str, float]:
    """Exact volumes of a subject in its session, cc, computed from the recipe alone.

    Raises:
        ValueError: there is no subject of that name.
    """
    solid = _subject(recipe)
    return solid.placed(rig_from_solid(solid, recipe.seed)).volumes_cc


def _subject(recipe: SessionRecipe) -> SubjectSolid:
    """The subject, with the operations of the situation."""
    operated = any(DISTURBANCES[disturbance.name].stage == "patient" for disturbance in recipe.situation.disturbances)
    return make_subject(
        recipe.subject,
        recipe.seed,
        edge_mm=_edge_mm(recipe.scale),
        mesh_file=recipe.mesh_file,
        reshape=partial(disturbed, stage="patient", situation=recipe.situation, seed=recipe.seed) if operated else None,
    )


def _edge_mm(scale: float) -> float:
    """Edge length of about 1.5 pixels, so that facets are not visible."""
    return float(np.clip(0.7 * 0.25 / scale, 0.4, 2.0))


def _check_cameras_see_target(rig: Rig, target: Target, poses: Mapping[str, Transform]) -> None:
    """Refuse a rig with a camera that never sees the target, because it could not be calibrated.

    Raises:
        SessionError: a camera sees the target in none of at least `_POSES_ENOUGH` poses.
    """
    for camera in rig.cameras.values() if len(poses) >= _POSES_ENOUGH else ():
        if not any(sees_target(camera, pose, target) for pose in poses.values()):
            raise SessionError(
                f"rig {rig.name}: camera {camera.name}",
                found=f"the {target.kind} target in none of {len(poses)} poses",
                expected="every camera to see the target, held in the rig's middle",
                remedy="Aim the camera at the middle, or give it a shorter focal length, or choose another --target",
            )


def _manifest(rig: Rig, target: Target, solid: SubjectSolid, made_by: str) -> str:
    """Text of session.toml for a rig, its target and the subject. `made_by` is the recipe."""
    pairs = ",\n".join(
        f'  {{ name = "{name}", left = "{left}", right = "{right}" }}' for name, (left, right) in rig.pair_names.items()
    )
    table = "\n".join(f"{name} = {json.dumps(value)}" for name, value in described(target).items())
    return f"""\
# A virtual capture. Its truth is in truth/, which only "mammometry evaluate" reads.
{made_by}
format = 1
units = "mm"

[rig]
name = "{rig.name}"
pairs = [
{pairs},
]

[target]
{table}

[subject]
kind = "{solid.subject_kind}"
{"" if solid.base_boundary is None else _SHARP_RIM}"""
