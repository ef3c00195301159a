"""Acceptance tests of a virtual rig with known errors, from photographs to verdict.

A pair of small cameras photographs a board, then a ball, a bar and a plane. mammometry calibrates, matches, fuses and
decides. The expected error of each artefact is computed from the true cameras: points of its surface are projected by
the cameras at the capture, and triangulated by those at the calibration.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mammometry.api.acceptance import run_acceptance
from mammometry.api.job import open_session
from mammometry.calibration.judge.reconstruction import triangulate
from mammometry.capture.sessions import take_over
from mammometry.geometry import Array, Float64
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
from mammometry.study.acceptance.evaluate import AcceptanceFinding, Outcome
from mammometry.study.acceptance.fits import SphereFit, fit_sphere
from mammometry.study.acceptance.patches import SpherePatch

RIG = Path(__file__).parent / "rigs" / "stand.toml"
RECIPE = SessionRecipe(rig=f"{RIG}:front", subject="test-sphere_1", scale=1.2, seed=3, poses=8)
SETTINGS = Settings()
_FACING = 0.55  # least cosine between a ball's normal and the lines of sight, of the points that both cameras match
_BALL_SCALES, _BALL_SEEDS = (0.6, 1.2), (3, 5)  # sizes of the photographs, and rigs
_DISTANCE_MM = 720.0  # of the cameras of this rig
_POINTS = 4000  # on a whole ball, or on a plane


@dataclass(frozen=True, slots=True, kw_only=True)
class RigFault:
    """A known error of the rig, and the artefacts that show it."""

    name: str
    artefacts: tuple[tuple[Kind, str], ...]
    """Kind and position of each."""
    situation: str = ""
    """Disturbance of the capture."""
    scale: float = 0.0
    """Relative error of all lengths: the board is smaller than stated by this share."""
    noise: float = 1.0
    """Noise relative to a usual sensor."""


ERRORS = (
    RigFault(name="none", artefacts=(("sphere", "1"), ("bar", "1"), ("plane", "1"))),
    RigFault(name="lengths 0.2 % too large", artefacts=(("sphere", "1"), ("bar", "1")), scale=0.002),
    RigFault(name="a camera turned by 0.05°", artefacts=(("bar", "1"), ("bar", "2")), situation="drift-one=0.05"),
    RigFault(name="k1 of the lenses changed by 0.05", artefacts=(("bar", "1"), ("plane", "1")), situation="lens=0.05"),
    RigFault(name="four times the noise", artefacts=(("sphere", "1"),), noise=4.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """The virtual rig, with its calibrations in a folder."""

    folder: Path
    recipe: SessionRecipe = RECIPE
    settings: Settings = SETTINGS

    def studio(self, scale: float = 0.0, noise: float = 1.0) -> Studio:
        """Speckled artefacts, and a board smaller than stated by a share."""
        board = replace(BOARD, square_mm=BOARD.square_mm * (1 - scale), marker_mm=BOARD.marker_mm * (1 - scale))
        return Studio(target=board, skin=make_skin("speckled"), film=Film().with_noise(noise))

    def calibration(self, scale: float) -> Path:
        """Folder of a calibrated session, made at the first call for each scale."""
        folder = self.folder / f"calibration-{scale:g}"
        if not folder.exists():
            write_session(folder, self.recipe, self.studio(scale), truth=False)
            _state_board(folder)
            open_session(folder, self.settings).calibrate()
        return folder

    def measured(self, error: RigFault, kind: Kind, position: str, out: Path) -> None:
        """Photograph an artefact with an error of the rig, into a session with the calibration's cameras."""
        calibrated = self.calibration(error.scale)
        recipe = replace(
            self.recipe, subject=f"test-{kind}_{position}", poses=1, situation=parse_situation(error.situation)
        )
        write_session(out, recipe, self.studio(error.scale, error.noise), truth=False)
        _state_board(out)
        shutil.rmtree(out / "calibration")
        shutil.copytree(calibrated / "calibration", out / "calibration")
        if not take_over(open_session(out, self.settings), open_session(calibrated, self.settings)):
            raise RuntimeError("the calibration was not taken over")

    def tested(self, error: RigFault) -> Outcome:
        """Acceptance test of the rig with an error."""
        folder = self.folder / error.name.replace(" ", "-").replace("%", "percent").replace("°", "deg")
        for kind, position in error.artefacts:
            (folder / kind).mkdir(parents=True, exist_ok=True)
            self.measured(error, kind, position, folder / kind / position)
        kinds = {kind for kind, _ in error.artefacts}
        (folder / DESCRIPTION).write_text(_described(kinds))
        return run_acceptance(folder, self.settings)

    def expected(self, error: RigFault, kind: Kind, position: str) -> dict[str, float]:
        """Quantity → error of an ideal measurement by cameras with this error, mm."""
        rig = make_rig(self.recipe.rig, self.recipe.scale, self.recipe.seed)
        exposure = disturbed(
            plain_exposure(rig, np.zeros((0, 4)), Film()), "shoot", parse_situation(error.situation), self.recipe.seed
        )
        solid = make_subject(f"test-{kind}_{position}", self.recipe.seed, edge_mm=2.0)
        solid = replace(solid, lean_rad=0.0)
        pose = rig_from_solid(solid, self.recipe.seed)
        place = next(one for one in POSITIONS[kind] if one.name == position)
        centre, axis = np.array(place.centre) * VOLUME_MM, np.array(place.axis)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-9)

        def seen(points: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
            (pair,) = rig.pairs
            used = exposure.capture_rig.cameras
            left_uv, right_uv = (used[camera.name].project(pose.apply(points)) for camera in (pair.left, pair.right))
            return (1 + error.scale) * triangulate(pair, left_uv, right_uv)

        def ball(middle: Float64[Array, 3], radius: float) -> SphereFit:
            directions = even_directions(_POINTS)
            facing = pose.rotate(directions)
            own = rig.cameras.values()
            towards = [camera.centre_world - pose.apply(middle[None])[0] for camera in own]
            shown = np.all([facing @ one > _FACING * np.linalg.norm(one) for one in towards], axis=0)
            return fit_sphere(seen(middle + radius * directions[shown]), np.ones(np.count_nonzero(shown)))

        match DRAWN[kind]:
            case Sphere(diameter_mm=diameter):
                return {"size": 2 * ball(centre, diameter / 2).radius_mm - diameter}
            case Bar(distance_mm=distance, diameter_mm=diameter):
                ends = [ball(centre + side * distance / 2 * axis, diameter / 2) for side in (-1, 1)]
                between = float(np.linalg.norm(ends[1].centre - ends[0].centre))
                grown = ends[0].radius_mm + ends[1].radius_mm - diameter
                return {"spacing": between - distance, "length": between - distance + grown}
            case _:
                across = np.cross(axis, [0.0, 1.0, 0.0])
                grid = np.stack(np.meshgrid(np.linspace(-80, 80, 50), np.linspace(-105, 105, 60)), axis=-1)
                flat = grid.reshape(-1, 2) @ np.array([across, np.cross(axis, across)])
                points = seen(centre + 3.0 * axis + flat)  # the plate's front
                moved = points - points.mean(axis=0)
                heights = moved @ np.linalg.svd(moved, full_matrices=False)[2][2]
                return {"flatness": float(np.ptp(np.percentile(heights, [2.5, 97.5])))}


def _state_board(session: Path) -> None:
    """Write the board's nominal size into a session's manifest."""
    path = session / "session.toml"
    sizes = {"square_mm": BOARD.square_mm, "marker_mm": BOARD.marker_mm}
    lines = [
        f"{name} = {sizes[name]}" if (name := line.partition(" = ")[0]) in sizes else line
        for line in path.read_text().splitlines()
    ]
    path.write_text("\n".join(lines) + "\n")


def _described(kinds: Collection[str]) -> str:
    """Description of a test with these artefacts."""
    head, *tables = DEMO_DEVICE.split("\n[")
    kept = [table for table in tables if table.partition("]")[0] in {"device", *kinds}]
    return "\n[".join([head, *kept])


def rows(folder: Path) -> Iterator[tuple[str, AcceptanceFinding, float]]:
    """Yield name of the rig's error, finding, and expected error (NaN: unknown)."""
    bench = Bench(folder=folder)
    for error in ERRORS:
        found = bench.tested(error).findings
        for kind, position in error.artefacts:
            ideal = bench.expected(error, kind, position)
            for finding in found:
                if (finding.kind, finding.position) == (kind, position):
                    yield error.name, finding, ideal.get(finding.quantity, math.nan)


def print_table() -> None:
    """Print the table of all errors."""
    print("| error of the rig | artefact | quantity | expected, mm | found, mm | ± 95 %, mm | decision |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory(prefix="mammometry-acceptance-") as made:
        for name, one, ideal in rows(Path(made)):
            known = "noise" if math.isnan(ideal) else f"{ideal:+.2f}"
            print(
                f"| {name} | {one.kind} {one.position} | {one.quantity} | {known} | {one.error:+.2f} | "
                f"{one.expanded:.2f} | {one.decision} |",
                flush=True,
            )


def print_balls() -> None:
    """Print how much too large balls come out in coarse and in finer photographs, without any error of the rig."""
    print("| photographs | balls | width, pixels | error of the diameter, mean, mm | SD, mm |")
    print("| --- | --- | --- | --- | --- |")
    error = replace(ERRORS[0], artefacts=(("sphere", "1"), ("bar", "1"), ("bar", "2")))
    for scale in _BALL_SCALES:
        errors: dict[float, list[float]] = {}
        for seed in _BALL_SEEDS:
            recipe = replace(RECIPE, scale=scale, seed=seed)
            with tempfile.TemporaryDirectory(prefix="mammometry-acceptance-") as made:
                for result in Bench(folder=Path(made), recipe=recipe).tested(error).results:
                    ball = DRAWN[result.kind]
                    if isinstance(ball, (Sphere, Bar)):
                        found = [2 * patch.fit.radius_mm for patch in result.patches if isinstance(patch, SpherePatch)]
                        errors.setdefault(ball.diameter_mm, []).extend(np.array(found) - ball.diameter_mm)
        left = make_rig(RECIPE.rig, scale, RECIPE.seed).pairs[0].left
        pixels_per_mm = left.matrix[0, 0] / _DISTANCE_MM
        for diameter, own in errors.items():
            print(
                f"| {left.size_wh[0]} × {left.size_wh[1]} | {len(own)} of {diameter:g} mm | "
                f"{diameter * pixels_per_mm:.0f} | {np.mean(own):+.2f} | {np.std(own, ddof=1):.2f} |",
                flush=True,
            )
