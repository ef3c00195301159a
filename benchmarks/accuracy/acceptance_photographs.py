"""Acceptance tests of a virtual rig with errors put in, from photographs to verdict.

A pair of small cameras photographs a board, then a ball, a bar and a plane. mammometry calibrates, matches, fuses and
judges. What the errors do to each artefact is computed from the true cameras: points of its surface are projected by
the cameras as they are at the capture, and triangulated by those of the calibration.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from mammometry.api.acceptance import run_acceptance
from mammometry.api.job import open_session
from mammometry.capture.sessions import take_over
from mammometry.geometry import Array, Camera, Float64, Rig
from mammometry.geometry.directions import even_directions
from mammometry.io.acceptance_file import DESCRIPTION
from mammometry.settings import Settings
from mammometry.simulate.artefacts import DEMO_DEVICE
from mammometry.simulate.disturbances.exposure import plain_exposure
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.rigs.targets import BOARD
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio
from mammometry.simulate.subjects.artefacts import DRAWN
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import rig_from_solid
from mammometry.study.acceptance.artefacts import POSITIONS, VOLUME_MM, Bar, Kind, Sphere
from mammometry.study.acceptance.evaluate import AcceptanceFinding

RIG = Path(__file__).parent / "rigs" / "stand.toml"
RECIPE = SessionRecipe(rig=f"{RIG}:front", subject="test-sphere_1", scale=0.6, seed=3, poses=8)
SETTINGS = Settings()
_FACING = 0.55  # least cosine between a ball's normal and the lines of sight, of the points that both cameras match
_POINTS = 4000  # on a whole ball, or on a plane


@dataclass(frozen=True, slots=True, kw_only=True)
class PutIn:
    """An error of the rig, and the artefacts that show it."""

    name: str
    artefacts: tuple[str, ...]
    """Kind and position, as in ``bar_1``."""
    situation: str = ""
    """Disturbance of the capture."""
    scale: float = 0.0
    """Relative error of all lengths: the board is smaller than stated by this."""
    noise: float = 1.0
    """Factor on the sensor's noise."""


ERRORS = (
    PutIn(name="none", artefacts=("sphere_1", "bar_1", "plane_1")),
    PutIn(name="lengths 0.2 % too large", artefacts=("sphere_1", "bar_1"), scale=0.002),
    PutIn(name="a camera turned by 0.05°", artefacts=("bar_1", "bar_2"), situation="drift-one=0.05"),
    PutIn(name="k1 of the lenses changed by 0.05", artefacts=("bar_1", "plane_1"), situation="lens=0.05"),
    PutIn(name="four times the noise", artefacts=("sphere_1",), noise=4.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """The virtual rig, its pictures and its calibrations, which are made once."""

    folder: Path
    recipe: SessionRecipe = RECIPE
    settings: Settings = SETTINGS

    def studio(self, scale: float = 0.0, noise: float = 1.0) -> Studio:
        """Speckled artefacts, and a board that is smaller than stated."""
        board = replace(BOARD, square_mm=BOARD.square_mm * (1 - scale), marker_mm=BOARD.marker_mm * (1 - scale))
        return Studio(target=board, skin=make_skin("speckled"), film=Film().with_noise(noise))

    def calibration(self, scale: float) -> Path:
        """A calibrated session, made at the first call for each scale."""
        folder = self.folder / f"calibration-{scale:g}"
        if not folder.exists():
            write_session(folder, self.recipe, self.studio(scale), truth=False)
            _state_board(folder)
            open_session(folder, self.settings).calibrate()
        return folder

    def measured(self, error: PutIn, artefact: str, out: Path) -> None:
        """Photograph an artefact with an error of the rig. The cameras are those of the calibration."""
        calibrated = self.calibration(error.scale)
        recipe = replace(self.recipe, subject=f"test-{artefact}", poses=1, situation=parse_situation(error.situation))
        write_session(out, recipe, self.studio(error.scale, error.noise), truth=False)
        _state_board(out)
        shutil.rmtree(out / "calibration")
        shutil.copytree(calibrated / "calibration", out / "calibration")
        if not take_over(open_session(out, self.settings), open_session(calibrated, self.settings)):
            raise RuntimeError("the calibration was not taken over")

    def tested(self, error: PutIn) -> tuple[AcceptanceFinding, ...]:
        """Findings of an acceptance test of the rig with an error."""
        folder = self.folder / error.name.replace(" ", "-").replace("%", "percent").replace("°", "deg")
        for artefact in error.artefacts:
            kind, _, position = artefact.partition("_")
            (folder / kind).mkdir(parents=True, exist_ok=True)
            self.measured(error, artefact, folder / kind / position)
        kinds = {artefact.partition("_")[0] for artefact in error.artefacts}
        (folder / DESCRIPTION).write_text(_described(kinds))
        return run_acceptance(folder, self.settings).findings

    def expected(self, error: PutIn, artefact: str) -> dict[str, float]:
        """Quantity → error of an ideal measurement by cameras with this error, mm."""
        rig = make_rig(self.recipe.rig, self.recipe.scale, self.recipe.seed)
        exposure = disturbed(
            plain_exposure(rig, np.zeros((0, 4)), Film()), "shoot", parse_situation(error.situation), self.recipe.seed
        )
        kind, _, position = artefact.partition("_")
        solid = make_subject(f"test-{artefact}", self.recipe.seed, edge_mm=2.0)
        solid = replace(solid, lean_rad=0.0)
        pose = rig_from_solid(solid, self.recipe.seed)
        place = next(one for one in POSITIONS[_KINDS[kind]] if one.name == position)
        centre, axis = np.array(place.centre) * VOLUME_MM, np.array(place.axis)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-9)

        def seen(points: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
            return (1 + error.scale) * _triangulated(rig, exposure.capture_rig, pose.apply(points))

        def ball(middle: Float64[Array, 3], radius: float) -> tuple[Float64[Array, 3], float]:
            directions = even_directions(_POINTS)
            facing = pose.rotate(directions)
            own = rig.cameras.values()
            towards = [camera.centre_world - pose.apply(middle[None])[0] for camera in own]
            shown = np.all([facing @ one > _FACING * np.linalg.norm(one) for one in towards], axis=0)
            return _sphere(seen(middle + radius * directions[shown]))

        match DRAWN[_KINDS[kind]]:
            case Sphere(diameter_mm=diameter):
                _, radius = ball(centre, diameter / 2)
                return {"size": 2 * radius - diameter}
            case Bar(distance_mm=distance, diameter_mm=diameter):
                ends = [ball(centre + side * distance / 2 * axis, diameter / 2) for side in (-1, 1)]
                between = float(np.linalg.norm(ends[1][0] - ends[0][0]))
                grown = ends[0][1] + ends[1][1] - diameter
                return {"spacing": between - distance, "length": between - distance + grown}
            case _:
                across = np.cross(axis, [0.0, 1.0, 0.0])
                grid = np.stack(np.meshgrid(np.linspace(-80, 80, 50), np.linspace(-105, 105, 60)), axis=-1)
                flat = grid.reshape(-1, 2) @ np.array([across, np.cross(axis, across)])
                points = seen(centre + 3.0 * axis + flat)  # the plate's front
                moved = points - points.mean(axis=0)
                heights = moved @ np.linalg.svd(moved, full_matrices=False)[2][2]
                return {"flatness": float(np.ptp(np.percentile(heights, [2.5, 97.5])))}


_KINDS: Mapping[str, Kind] = {"sphere": "sphere", "bar": "bar", "plane": "plane"}


def _triangulated(known: Rig, used: Rig, points: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
    """Points as the known cameras place them, from their images in the cameras that were used."""
    rays: list[tuple[Camera, Float64[Array, "n 3"]]] = []
    for name, camera in known.cameras.items():
        rays.append((camera, camera.rays_world(used.cameras[name].project(points))))
    (first, one), (second, other) = rays
    base = second.centre_world - first.centre_world
    cosine = (one * other).sum(axis=1)
    along = (base @ one.T - cosine * (base @ other.T)) / (1 - cosine**2)
    back = (cosine * (base @ one.T) - base @ other.T) / (1 - cosine**2)
    nearest = first.centre_world + along[:, None] * one, second.centre_world + back[:, None] * other
    return np.asarray((nearest[0] + nearest[1]) / 2)


def _sphere(points: Float64[Array, "n 3"]) -> tuple[Float64[Array, 3], float]:
    middle = points.mean(axis=0)

    def deviations(unknown: Float64[Array, " 4"]) -> Float64[Array, " n"]:
        return np.asarray(np.linalg.norm(points - middle - unknown[:3], axis=1) - unknown[3])

    found = least_squares(deviations, np.array([0.0, 0.0, -30.0, 50.0])).x
    return found[:3] + middle, float(found[3])


def _state_board(session: Path) -> None:
    """Write the board's nominal size into a session's manifest."""
    path = session / "session.toml"
    sizes = {"square_mm": BOARD.square_mm, "marker_mm": BOARD.marker_mm}
    lines = [
        f"{name} = {sizes[name]}" if (name := line.partition(" = ")[0]) in sizes else line
        for line in path.read_text().splitlines()
    ]
    path.write_text("\n".join(lines) + "\n")


def _described(kinds: set[str]) -> str:
    """Description of a test with these artefacts."""
    head, *tables = DEMO_DEVICE.split("\n[")
    kept = [table for table in tables if table.partition("]")[0] in {"device", *kinds}]
    return "\n[".join([head, *kept])


def rows(folder: Path) -> Iterator[tuple[str, AcceptanceFinding, float]]:
    """Error put in, what was found, and the error that the true cameras give (NaN: none)."""
    bench = Bench(folder=folder)
    for error in ERRORS:
        found = bench.tested(error)
        for artefact in error.artefacts:
            kind, _, position = artefact.partition("_")
            ideal = bench.expected(error, artefact)
            for finding in found:
                if (finding.kind, finding.position) == (kind, position):
                    yield error.name, finding, ideal.get(finding.quantity, math.nan)


def print_table() -> None:
    """Print the table of all errors."""
    print("| error put in | artefact | quantity | expected, mm | found, mm | ± 95 %, mm | decision |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory(prefix="mammometry-acceptance-") as made:
        for name, one, ideal in rows(Path(made)):
            known = "noise" if math.isnan(ideal) else f"{ideal:+.2f}"
            print(
                f"| {name} | {one.kind} {one.position} | {one.quantity} | {known} | {one.error:+.2f} | "
                f"{one.expanded:.2f} | {one.decision} |",
                flush=True,
            )
