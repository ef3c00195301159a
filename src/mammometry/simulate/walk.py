"""Photographs by a virtual telephone during a walk around a standing woman.

She wears the printed board. The folder contains the input for `mammometry photos`, and ``truth/``. The body's frame is
that of the solid: y up, z ahead, mm. The sizes of walk, light and telephone are made up; no measurement uses them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
from scipy import ndimage

from mammometry.base.errors import SessionError, StorageError
from mammometry.base.machine.cores import available_cores
from mammometry.base.new_folder import require_new, whole_folder
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.targets.board import FlatBody
from mammometry.calibration.targets.card_field import FIELD_MIDDLE, field_sheet
from mammometry.calibration.targets.table import target_from_table
from mammometry.geometry import Array, Camera, Float32, Float64, Transform
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.simulate.disturbances.about import Surroundings
from mammometry.simulate.disturbances.registry import as_truth, check, disturbed
from mammometry.simulate.disturbances.walks import WalkConditions, still_walk
from mammometry.simulate.recipe import Situation, parse_situation
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.printed_board import bank_card, printed_board
from mammometry.simulate.rendering.render import render_subject
from mammometry.simulate.rendering.scene import Prop, Room, StudioScene, SubjectMotion, light_scene, moved
from mammometry.simulate.rendering.skin import SKINS, SkinReflectance
from mammometry.simulate.rigs.poses import looking
from mammometry.simulate.studio import finish, refusing, take_picture
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import SubjectSolid
from mammometry.walk.region import TELEPHONE_BOARD

PHOTOGRAPHS, TRUTH = "photos", "truth"
"""Folders of a walk."""
BOARD = "board.toml"
_STANDING, _UNDISTURBED = parse_situation("posture=standing"), Situation()
_FILM = Film(vignetting=0.15, electrons=9000.0, jpeg_quality=92, chroma_halved=True)
_SIZE_WH = (4032, 3024)  # of a photograph at full size
_FOCAL = 0.74  # focal length relative to the picture's width: 26 mm on a frame of 36 mm, as in main cameras
_DISTORTION = (0.05, -0.1, 0.0, 0.0, 0.0)  # about 1 % in the corners
_ARC_DEG, _HEIGHTS_DEG = 62.0, (-30.0, 12.0)  # largest angle to either side, and elevations of the two passes
_JITTER_DEG, _AIM_MM, _ROLL_RAD = 1.5, 15.0, 0.03  # standard deviations of the telephone's position and direction
_DISTANCE_MM = (560.0, 640.0)  # smallest and largest, from the midpoint between breasts and board
_LAMPS_MM = ((-900.0, 700.0, 1300.0), (900.0, 600.0, 1300.0), (0.0, 150.0, 1700.0))  # positions in front of the chest
_BRIGHTNESS = 1.1  # radiance of white paper that faces the middle lamp; full scale is 1
_BELOW_FOLD_MM = 50.0  # distance of the board's upper edge from the lowest fold
_GAP_MM = 2.0  # distance between the board and the nearest skin
_EDGE_MM = 0.4  # edge of the triangles on the breasts for photographs at full size: about two pixels
_CARD_GREYS = {"grey": 0.3, "white": 0.75, "black": 0.03}  # reflectance of bank cards
_CARD_ASIDE_MM, _CARD_TURN_RAD = np.array([0.8, -0.6]), 0.017  # offset from the field, as of a card placed by hand
_BREATH_AHEAD = (0.0, 0.3, 0.95)  # direction in which the chest moves when breathing in


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkRecipe:
    """A virtual walk."""

    subject: str = "torso_2"
    """A torso in `subjects.registry.SUBJECTS`."""
    seed: int = 7
    """Seed of all random values."""
    pictures: int = 24
    """Number of photographs, half of them at each height."""
    scale: float = 0.4
    """Size of the photographs relative to a telephone's 4032 × 3024 pixels."""
    skin: SkinReflectance = SKINS["skin"]
    film: Film = _FILM
    situation: Situation = _UNDISTURBED
    """Disturbances of the patient, her skin, her surroundings and the walk."""

    @property
    def line(self) -> str:
        """Comment in board.toml that states how the walk was made."""
        made = f"# subject {self.subject}, seed {self.seed}, {self.pictures} photographs, scale {self.scale}"
        return f"{made}, disturbed by {self.situation}" if self.situation.disturbances else made


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedWalk:
    """A rendered walk and its truth, body's frame, mm."""

    folder: Path
    cameras: Mapping[str, Camera]
    """Number of a photograph → its camera."""
    true_volumes_cc: Mapping[str, float]
    """Side → exact volume, cc."""


def woman_of(recipe: WalkRecipe) -> SubjectSolid:
    """The standing woman of a walk.

    Raises:
        ValueError: the subject is unknown, or is not a patient.
    """
    posed = replace(recipe.situation, disturbances=(*_STANDING.disturbances, *recipe.situation.disturbances))
    reshape = partial(disturbed, stage="patient", situation=posed, seed=recipe.seed)
    return make_subject(
        recipe.subject, recipe.seed, edge_mm=float(np.clip(_EDGE_MM / recipe.scale, 0.5, 3.0)), reshape=reshape
    )


def write_walk(out: Path, recipe: WalkRecipe = WalkRecipe(), *, progress: Progress = no_progress) -> SimulatedWalk:
    """Render a walk with its truth into a new folder: ``photos/`` with ``board.toml``, and ``truth/``.

    Args:
        out: folder to create. It must be empty or not exist.
        recipe: the woman and the walk.
        progress: called with the fraction of the photographs that are written.

    Raises:
        SessionError: `out` is not empty, or the recipe cannot be rendered.
        StorageError: the disk is full or read-only.
    """
    require_new(out)
    seed, situation = recipe.seed, recipe.situation
    with refusing(
        SessionError,
        expected="a torso, and disturbances of the patient, her skin, her surroundings or the walk",
        remedy="Correct the argument; --help names the choices",
    ):
        check(situation, without="shoot")
        woman = woman_of(recipe)
        walk: WalkConditions = disturbed(still_walk(recipe.pictures), "walk", situation, seed)
        skin: SkinReflectance = disturbed(recipe.skin, "skin", situation, seed)
        about = Surroundings(solid=woman, rig_from_solid=Transform.identity(), skin=skin)
        about = disturbed(about, "thing", situation, seed)
    board = _printed(walk.print_scale)
    placed = _worn(woman, board)
    lamps = _lamps()
    scene = light_scene(
        woman,
        Transform.identity(),
        lamps,
        Room(clutter=True, things=(*_print(board, placed, walk), *about.things)),
        skin=skin,
        seed=seed,
    )
    chest = np.mean([woman.landmarks[f"nipple_{side}"][0] for side in woman.breasts], axis=0)
    cameras = _cameras(recipe, walk, 0.5 * (chest + placed.apply(board.middle_mm[None])[0]))
    try:
        with whole_folder(out) as made:
            (made / PHOTOGRAPHS).mkdir()
            shot = replace(recipe, skin=skin)
            _photograph(made / PHOTOGRAPHS, shot, cameras, walk, partial(_breathing, scene, walk, chest), progress)
            (made / PHOTOGRAPHS / BOARD).write_text(_described(recipe), encoding="utf-8")
            (made / TRUTH).mkdir()
            write_ply(made / TRUTH / "body.ply", woman.mesh)
            truth = _truth(woman, placed, cameras, walk, situation)
            (made / TRUTH / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise StorageError(
            str(out),
            found=error.strerror or str(error),
            expected="a folder that can be written, with room for the photographs",
            remedy="Free some space or choose another place",
        ) from None
    return SimulatedWalk(
        folder=out,
        cameras=MappingProxyType(cameras),
        true_volumes_cc=MappingProxyType(woman.volumes_cc),
    )


def _printed(scale: float) -> FlatBody:
    """The telephone's board, printed at a given scale."""
    table = dict(TELEPHONE_BOARD)
    sizes = {name: scale * table[name] for name in ("square_mm", "marker_mm")}
    body = target_from_table({**table, **sizes}).body
    assert isinstance(body, FlatBody)
    return body


def _print(board: FlatBody, placed: Transform, walk: WalkConditions) -> tuple[Prop, ...]:
    """The board, and the bank card on it if there is one."""
    printed = partial(printed_board, board, placed, stretch=walk.stretch, bow_mm=walk.bow_mm)
    if not walk.card:
        return (printed(),)
    middle = walk.print_scale * np.array(FIELD_MIDDLE) + _CARD_ASIDE_MM
    return (
        printed(field_sheet(walk.print_scale)),
        bank_card(middle, _CARD_TURN_RAD, placed, _CARD_GREYS[walk.card]),
    )


def _described(recipe: WalkRecipe) -> str:
    """Content of board.toml: the nominal size, with a standard uncertainty of 0.1 mm."""
    columns, _ = TELEPHONE_BOARD["squares"]
    described = {**TELEPHONE_BOARD, "edge_mm": columns * TELEPHONE_BOARD["square_mm"], "edge_std_mm": 0.1}
    return "\n".join([recipe.line, *(f"{name} = {json.dumps(value)}" for name, value in described.items()), ""])


def _worn(woman: SubjectSolid, board: FlatBody) -> Transform:
    """Pose of the board on the belly: below the folds, resting on the skin, with its text upright."""
    mesh = woman.mesh
    lowest = min(float(mesh.vertices[breast.boundary, 1].min()) for breast in woman.breasts.values())
    (left, top), (right, bottom) = board.paper_mm
    middle = float(woman.landmarks["midline"][:, 0].mean())
    upper = lowest - _BELOW_FOLD_MM
    x, y, z = mesh.vertices.T
    behind = (np.abs(x - middle) < 0.5 * (right - left)) & (y < upper) & (y > upper - (bottom - top))
    third = (bottom - top) / 3.0
    above, below = (float(z[behind & near].max()) for near in (y > upper - third, y < upper - 2.0 * third))
    lean = math.atan2(below - above, 2.0 * third)  # its lower edge is as far forward as the belly
    across = np.array([1.0, 0.0, 0.0])
    down = np.array([0.0, -math.cos(lean), math.sin(lean)])
    away = np.cross(across, down)  # away from the reader of the print
    out = -away
    start = np.array([middle, upper, 0.0])
    lift = float(((mesh.vertices[behind] - start) @ out).max()) + _GAP_MM
    rotation = np.stack([across, down, away], axis=1)
    corner = start + lift * out - rotation @ np.array([0.5 * (left + right), top, 0.0])
    return Transform(rotation=rotation, translation_mm=corner)


def _lamps() -> Float64[Array, "l 4"]:
    """Lamps in front of the chest: position, mm, and irradiance × mm² at distance 1."""
    positions = np.array(_LAMPS_MM)
    distances = np.linalg.norm(positions, axis=1)
    total = float((positions[:, 2] / distances**3).sum())
    return np.column_stack([positions, np.full(len(positions), _BRIGHTNESS / total)])


def _cameras(recipe: WalkRecipe, walk: WalkConditions, aim: Float64[Array, 3]) -> dict[str, Camera]:
    """Number of a photograph → camera, body's frame. They share a lens, apart from its focus and stabilisation.

    Args:
        recipe: the walk.
        walk: its disturbances.
        aim: point at which the telephone looks, mm.
    """
    rng = np.random.default_rng([recipe.seed, 59])
    width, height = (round(recipe.scale * side) for side in _SIZE_WH)
    focal_px = _FOCAL * width * rng.normal(1.0, 0.01)
    middle = np.array([0.5 * (width - 1), 0.5 * (height - 1)]) + rng.normal(0.0, 0.003 * height, 2)
    cameras: dict[str, Camera] = {}
    half = (recipe.pictures + 1) // 2
    azimuths_deg = np.linspace(-_ARC_DEG, _ARC_DEG, half)
    stations = [(azimuth, height) for height in _HEIGHTS_DEG for azimuth in azimuths_deg][: recipe.pictures]
    for number, station_deg in enumerate(stations):
        azimuth, elevation = np.radians(np.array(station_deg) + rng.normal(0.0, _JITTER_DEG, 2))
        out = np.array(
            [math.sin(azimuth) * math.cos(elevation), math.sin(elevation), math.cos(azimuth) * math.cos(elevation)]
        )
        centre = aim + rng.uniform(*_DISTANCE_MM) * out
        name, focal = f"{number + 1:02d}", focal_px * walk.focal[number]
        column, row = middle + recipe.scale * walk.centre_px[number]
        cameras[name] = Camera(
            name=name,
            size_wh=(width, height),
            matrix=np.array([[focal, 0.0, column], [0.0, focal, row], [0.0, 0.0, 1.0]]),
            distortion=np.array(_DISTORTION),
            camera_from_world=looking(centre, aim + rng.normal(0.0, _AIM_MM, 3), rng.normal(0.0, _ROLL_RAD)),
        )
    return cameras


def _photograph(
    folder: Path,
    recipe: WalkRecipe,
    cameras: Mapping[str, Camera],
    walk: WalkConditions,
    at: Callable[[int], StudioScene],
    progress: Progress,
) -> None:
    """Write all photographs. `at` returns the scene of a photograph by its index."""

    def take(number: int, camera: Camera) -> None:
        def render() -> Float32[Array, "h w 3"]:
            image = render_subject(
                at(number),
                camera,
                recipe.skin,
                seed=recipe.seed,
                aperture=recipe.film.aperture(camera),
                background=recipe.film.stray_light,
            )
            image = skewed(image, recipe.scale * walk.skew_px[number])
            return smeared(image, recipe.scale * walk.blur_px[number], recipe.scale * walk.ghost_px[number])

        noise = int(np.random.default_rng([recipe.seed, 32, number]).integers(1 << 62))
        take_picture(folder / f"{camera.name}.jpg", render, recipe.film, noise)

    with ThreadPoolExecutor(max(1, min(len(cameras), available_cores()))) as pool:
        taking = [pool.submit(take, number, camera) for number, camera in enumerate(cameras.values())]
        finish(pool, taking, progress)


def skewed(image: Float32[Array, "h w 3"], last_row_px: Float64[Array, 2]) -> Float32[Array, "h w 3"]:
    """The image of a camera that rotates while its rows are read.

    Each row is shifted in proportion to its number.

    Args:
        image: image with all rows read at the same time as the middle row.
        last_row_px: shift (column, row) of the last row relative to the first, pixels.
    """
    if not last_row_px.any():
        return image
    height, width = image.shape[:2]
    late = (np.arange(height) / (height - 1) - 0.5)[:, None]
    rows = np.arange(height)[:, None] - late * last_row_px[1] + np.zeros(width)
    columns = np.arange(width) - late * last_row_px[0]
    moved = [ndimage.map_coordinates(image[..., band], [rows, columns], order=3, mode="nearest") for band in range(3)]
    return np.maximum(np.stack(moved, axis=-1), np.float32(0))


def smeared(image: Float32[Array, "h w 3"], blur_px: float, ghost_px: Float64[Array, 2]) -> Float32[Array, "h w 3"]:
    """The image of a camera that is out of focus, or that moves between two exposures.

    Args:
        image: a sharp image.
        blur_px: standard deviation of the blur, pixels.
        ghost_px: shift (column, row) between the two exposures of which the image is the mean, pixels.
    """
    if ghost_px.any():
        second = ndimage.shift(image, (ghost_px[1], ghost_px[0], 0.0), order=1, mode="nearest")
        image = (image + second) / 2
    if blur_px > 0.0:
        image = ndimage.gaussian_filter(image, (blur_px, blur_px, 0.0))
    return image.astype(np.float32, copy=False)


def _breathing(scene: StudioScene, walk: WalkConditions, chest: Float64[Array, 3], number: int) -> StudioScene:
    """Scene of a photograph, with the chest displaced by breathing."""
    breath_mm, still = walk.breath_mm[number] * np.array(_BREATH_AHEAD), np.zeros(3)
    if not breath_mm.any():
        return scene
    return moved(scene, SubjectMotion(sway_mm_s=still, turn_rad_s=still, breath_mm_s=breath_mm, chest=chest), 1.0)


def _truth(
    woman: SubjectSolid,
    body_from_board: Transform,
    cameras: Mapping[str, Camera],
    walk: WalkConditions,
    situation: Situation,
) -> dict[str, object]:
    return {
        "subject": woman.name,
        "true_volumes_cc": {side: round(volume, 3) for side, volume in woman.volumes_cc.items()},
        "nipples": [woman.landmarks[f"nipple_{side}"][0].tolist() for side in woman.breasts],
        "board_pose": body_from_board.matrix.tolist(),
        "print_scale": walk.print_scale,
        "stretch": walk.stretch,
        "bow_mm": walk.bow_mm,
        "breath_mm": [round(float(depth), 4) for depth in walk.breath_mm],
        "skew_px": walk.skew_px.tolist(),
        "blur_px": walk.blur_px.tolist(),
        "ghost_px": walk.ghost_px.tolist(),
        "cameras": {
            name: {
                "matrix": camera.matrix.tolist(),
                "distortion": camera.distortion.tolist(),
                "camera_from_body": camera.camera_from_world.matrix.tolist(),
            }
            for name, camera in cameras.items()
        },
        "disturbances": as_truth(situation),
    }
