"""A session of a few rendered photographs of the board, and later exposures of it: no subject, nothing to measure."""

from collections.abc import Mapping
from pathlib import Path

from PIL import Image

from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.poses import draw_poses
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.rigs.targets import BOARD, sees_target

MANIFEST = """\
format = 1
units = "mm"
[rig]
name = "small"
pairs = [
{pairs}
]
[target]
kind = "charuco"
squares = [14, 10]
square_mm = 25.0
marker_mm = 18.0
dictionary = "DICT_5X5_250"
[subject]
kind = "model"
"""


def small_rig() -> Rig:
    """Four cameras of the reference rig at an eighth of its size (563 × 375 pixels)."""
    return make_rig("reference:front,floor", 1 / 8, 7)


def expose(folder: Path, cameras: Mapping[str, Camera], rig_from_board: Transform, seed: int) -> None:
    """Photograph the board with all cameras that see it."""
    folder.mkdir(parents=True)
    film = Film()
    for number, (name, camera) in enumerate(cameras.items()):
        if sees_target(camera, rig_from_board, BOARD):
            radiance = render_target(camera, rig_from_board, BOARD, flashes(), background=film.stray_light)
            taken = develop(radiance, film, name=name, seed=100 * seed + number)
            Image.fromarray(taken.pixels).save(folder / f"{name}.png")


def write_board_session(folder: Path, poses: int) -> tuple[Rig, dict[str, Transform]]:
    """Write the manifest and calibration photographs; returns the true rig, and twice as many poses as it shows."""
    rig = small_rig()
    placed = draw_poses(rig, BOARD, 2 * poses, 3)
    for seed, pose in enumerate(list(placed)[:poses]):
        expose(folder / "calibration" / pose, rig.cameras, placed[pose], seed)
    pairs = ",\n".join(
        f'{{ name = "{name}", left = "{left}", right = "{right}" }}' for name, (left, right) in rig.pair_names.items()
    )
    (folder / "session.toml").write_text(MANIFEST.format(pairs=pairs))
    return rig, placed
