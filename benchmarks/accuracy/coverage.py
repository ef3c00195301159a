"""Coverage of the 95 % intervals on rendered captures, or on surfaces with random errors.

    python -m benchmarks.accuracy.coverage --captures 60 --out build/coverage
    python -m benchmarks.accuracy.coverage --captures 16 --first 61 --out build/held_out
    python -m benchmarks.accuracy.coverage --surfaces 31 --families torso woman leaning-woman

--captures simulates sessions (`benchmarks.accuracy.captures`) and measures them: nothing but photographs goes in. It
resumes: what is there is not made again, but measured again. --surfaces needs no photographs: to the true skin of so
many casts, and bodies of each family, it adds errors as the stages make them (scale, cameras, matching, base). Their
tails are heavier than the interval takes them to have, and it is told their size only by an estimate. The boundary is
drawn by another hand, and of some trunks less of the sides is seen. A cast has one volumes, a torso two. A torso's are
also compared *as defined*: with what the same wall makes of true skin and boundary, by their interval before it; a
woman's down to the muscle, too.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from benchmarks.accuracy.captures import CHOSEN_ON, in_rounds, made, measured, recipe
from benchmarks.accuracy.walls import TrueTorso, as_seen, true_torso
from benchmarks.accuracy.women import FAMILIES
from benchmarks.road import each_as_it_ends
from mammometry.base.errors import MammometryError
from mammometry.base.progress import StageProgress
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.truth import read_volumes
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.volume import volumes
from mammometry.measure.volume.boundary_jitter import displacements_mm, redraw
from mammometry.measure.volume.difference import difference
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.uncertainty import EarlierErrors, VolumeEvidence
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast, open_breasts
from mammometry.simulate.rigs.build import FULL_SIZE_WH
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import SubjectSolid, waves

_SINK_MM = 3.0
_AS_DEFINED, _TO_MUSCLE, _SIDES = ", as defined", ", to the muscle", "left less right"
_TAILS = 4.0
"""Degrees of freedom of Student's distribution, scaled to unit variance, from which common errors are drawn: errors
beyond three standard deviations are five times as frequent as a normal distribution has them."""
_CAMERAS = 8
"""Of the reference rig, which all captures but a few have."""
_CERTIFICATE = 12
"""Observations from which a calibration estimates its own errors: an interval is told a σ that is a fifth off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnErrors:
    """Standard deviations of the random errors, not taken from the settings of the intervals."""

    scale: float = 1e-3
    """Of every length: a board of 350 mm measured to a third of a millimetre, with a ruler."""
    cameras_mm: float = 0.05
    """Long waves of the surface, of the cameras: a few hundredths are usual for a pair (docs/calibration)."""
    common_mm: float = 0.04
    """Bias of a whole skin: of simulated captures' surfaces (decision 9)."""
    patches_mm: float = 0.08
    """RMS of patches of 4 to 20 mm, of the same surfaces."""
    base_mm: float = 0.07
    """Height of a cast's base: half of the .14 mm to which a rim's radius is known (decision 17)."""
    observers_mm: tuple[float, float] = (2.5, 4.7)
    """A boundary by another hand: published observers differ by 3.5 to 6.7 mm, each one's share is √½ of it."""
    seen_cosine: tuple[float, float] = (-0.3, 0.3)
    """How far around a trunk cameras see its skin: least cosine of its normal to straight ahead."""


@dataclass(frozen=True)
class Held:
    """Error of one volume, with the half-width of its interval."""

    subject: str
    volume: str
    error_cc: float
    half_cc: float
    """Half-width of the interval."""

    @property
    def holds(self) -> bool:
        """Whether the interval contains the true volume."""
        return abs(self.error_cc) <= self.half_cc


def _drawn(rng: np.random.Generator, tails: float = _TAILS) -> float:
    """Random error of unit variance, from Student's distribution."""
    return float(rng.normal() if np.isinf(tails) else rng.standard_t(tails) / np.sqrt(tails / (tails - 2)))


def _estimated(sigma: float, rng: np.random.Generator) -> float:
    """Estimate of a standard deviation by a calibration's observations."""
    return float(sigma * np.sqrt(rng.chisquare(_CERTIFICATE) / _CERTIFICATE))


def _certificate(errors: DrawnErrors, rng: np.random.Generator) -> EarlierErrors:
    return EarlierErrors(
        scale_std=_estimated(errors.scale, rng), point_std_mm=_estimated(errors.cameras_mm, rng) * np.sqrt(3)
    )


def surfaces(
    count: int, first: int = 1, settings: MeasureSettings = MeasureSettings(), *, families: Sequence[str] = ("torso",)
) -> Iterator[Held]:
    """Casts and bodies of every family, `count` of each, with random errors."""
    for number in range(first, first + count):
        for family in families:
            yield from _torso(true_torso(f"{family}_{number}", 0, edge_mm=2.5), number, settings)
        yield _cast(f"plaster_{(number - 1) % 9 + 1}", number, settings)


def _torso(true: TrueTorso, seed: int, settings: MeasureSettings) -> Iterator[Held]:
    rng, errors = np.random.default_rng([seed, 11]), DrawnErrors()
    earlier = _certificate(errors, rng)
    scale = 1 + errors.scale * _drawn(rng)
    seen = as_seen(true.surface.mesh, rng.uniform(*errors.seen_cosine))
    surface = replace(seen, mesh=disturbed(seen.mesh, scale, rng, tails=_TAILS))
    hand_mm = rng.uniform(*errors.observers_mm)
    drawn = []
    for boundary in true.boundaries:
        modes = displacements_mm(np.full(len(boundary.points_world), hand_mm))
        moved = replace(boundary, points_world=boundary.points_world * scale)
        drawn.append(redraw(moved, rng.normal(size=len(modes)) @ modes, surface.mesh))
    truth_cc, both = true.solid.volumes_cc, []
    for breast in open_breasts(drawn, surface, settings):
        boundary, found = breast.boundary, volumes.measure_volume(breast, VolumeEvidence(earlier=earlier))
        yield Held(true.solid.name, boundary.name, found.volume_cc - truth_cc[boundary.name], half_width_cc(found))
        yield as_defined(found, true, settings)
        if muscle_cc := _muscle_cc(true.solid):
            of_muscle = to_muscle(found, muscle_cc[boundary.name])
            yield replace(of_muscle, subject=true.solid.name)
        both.append(found)
    yield replace(_of_both_sides(both, truth_cc), subject=true.solid.name)


def _muscle_cc(solid: SubjectSolid) -> Mapping[str, float]:
    volumes_cc = solid.facts.get("muscle_volumes_cc", {})
    assert isinstance(volumes_cc, Mapping)
    return volumes_cc


def _cast(name: str, seed: int, settings: MeasureSettings) -> Held:
    rng, errors = np.random.default_rng([seed, 12]), DrawnErrors()
    earlier = _certificate(errors, rng)
    solid = make_subject(name, seed, edge_mm=2.0)
    assert solid.base_boundary is not None
    vertices = solid.mesh.vertices.copy()
    vertices[len(vertices) - solid.back_vertices :, 2] -= _SINK_MM  # an unseen back is closed behind the base
    scale = 1 + errors.scale * _drawn(rng)
    mesh = disturbed(TriangleMesh(vertices=vertices, faces=solid.mesh.faces), scale, rng, tails=_TAILS)
    rim = solid.base_boundary * scale + [0.0, 0.0, errors.base_mm * _drawn(rng)]
    boundary = Boundary(name="model", points_world=rim, method="drawn", sigma_mm=_estimated(errors.base_mm, rng))
    surface = as_seen(mesh)
    wall = chest_wall.fit(OpenBreast(boundary=boundary, surface=surface, settings=settings))
    found = volumes.measure(boundary, wall, settings, evidence=VolumeEvidence(surface=surface, earlier=earlier))
    return Held(f"{name}, seed {seed}", "model", found.volume_cc - solid.volume_cc, half_width_cc(found))


def half_width_cc(found: VolumeMeasurement) -> float:
    """Half-width of a volume's interval, cc, not cut at zero."""
    assert found.interval_cc is not None
    return found.interval_cc[1] - found.volume_cc


def as_defined(found: VolumeMeasurement, true: TrueTorso, settings: MeasureSettings = MeasureSettings()) -> Held:
    """A torso's volume in front of the named wall, with that of true skin and boundary."""
    assert found.as_defined_cc is not None
    exact = next(boundary for boundary in true.boundaries if boundary.name == found.name)
    breast = OpenBreast(boundary=exact, surface=true.surface, settings=settings, boundaries=true.boundaries)
    same = chest_wall.fit(breast, found.wall_kind)
    error_cc = found.volume_cc - same.closed.volume_mm3() / 1000
    return Held(true.solid.name, f"{found.name}{_AS_DEFINED}", error_cc, found.as_defined_cc[1] - found.volume_cc)


def to_muscle(found: VolumeMeasurement, truth_cc: float) -> Held:
    """A woman's volume down to the muscle, measured from the skin."""
    muscle = next(one for one in found.definitions if one.meaning == "muscle")
    return Held("", f"{found.name}{_TO_MUSCLE}", muscle.volume_cc - truth_cc, muscle.interval_cc[1] - muscle.volume_cc)


EARLIER = EarlierErrors(scale_std=DrawnErrors().scale, point_std_mm=DrawnErrors().cameras_mm * np.sqrt(3))


def disturbed(mesh: TriangleMesh, scale: float, rng: np.random.Generator, tails: float = np.inf) -> TriangleMesh:
    """Skin with errors along its normals: common, by cameras (long waves), by matching (short ones)."""
    normals = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], mesh.face_vectors())
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    errors = DrawnErrors()
    along: Float64[Array, " n"] = errors.common_mm * _drawn(rng, tails) + (
        errors.cameras_mm * waves(mesh.vertices, rng, shortest_mm=150, longest_mm=600)
        + errors.patches_mm * waves(mesh.vertices, rng, shortest_mm=4, longest_mm=20)
    )
    return TriangleMesh(vertices=(mesh.vertices + along[:, None] * normals) * scale, faces=mesh.faces)


def rendered(count: int, out: Path, scale: float, first: int = 1, scheduler: str | None = None) -> Iterator[Held]:
    """Volumes of all captures, measured in parallel. Refused ones are printed and left out."""
    width, height = FULL_SIZE_WH
    megapixels = _CAMERAS * width * height * scale**2 / 1e6
    for numbers in in_rounds(count, first):
        wanted = {recipe(number).name: (number, str(out.absolute()), scale) for number in numbers}
        for name, (refused, held) in each_as_it_ends(one_capture, wanted, megapixels=megapixels, scheduler=scheduler):
            if refused:
                print(f"{name}: refused: {refused}", flush=True)
            yield from (Held(**one) for one in held)


def one_capture(progress: StageProgress, number: int, out: str, scale: float) -> tuple[str, list[dict[str, Any]]]:
    """Refusal (or "") and volumes of one simulated capture, as JSON."""
    progress("capture", 0.0)
    wanted = recipe(number)
    session, refused = made(wanted, Path(out), scale)
    progress("measure", 0.5)
    truth_cc = read_volumes(session / "truth")
    found: tuple[VolumeMeasurement, ...] = ()
    if not refused:
        try:
            found, without = measured(session, scale)
            refused = "; ".join(f"{side}: {why}" for side, why in without.items())
        except MammometryError as error:
            refused = str(error)
    held = [Held(wanted.name, one.name, one.volume_cc - truth_cc[one.name], half_width_cc(one)) for one in found]
    if found and "model" not in truth_cc:
        true = true_torso(wanted.subject, wanted.seed)
        held += [replace(as_defined(one, true), subject=wanted.name) for one in found]
        muscle_cc = _muscle_cc(true.solid)
        held += [replace(to_muscle(one, muscle_cc[one.name]), subject=wanted.name) for one in found if muscle_cc]
    if len(found) == 2:
        held.append(replace(_of_both_sides(found, truth_cc), subject=wanted.name))
    return refused or "", [asdict(one) for one in held]


def _of_both_sides(found: Sequence[VolumeMeasurement], truth_cc: Mapping[str, float]) -> Held:
    """Left minus right of a torso, with the interval of the difference."""
    left, right = sorted(found, key=lambda one: one.name)
    verdict = difference(left, right, "sides")
    assert verdict.difference_interval_cc is not None
    error_cc = verdict.difference_cc - (truth_cc["left"] - truth_cc["right"])
    return Held("", _SIDES, error_cc, verdict.difference_interval_cc[1] - verdict.difference_cc)


def share_interval(part: int, whole: int) -> tuple[float, float]:
    """95 % interval of a share, `part` of `whole` (Clopper and Pearson)."""
    low = float(beta.ppf(0.025, part, whole - part + 1)) if part else 0.0
    return low, float(beta.ppf(0.975, part + 1, whole - part)) if part < whole else 1.0


def summary(held: list[Held]) -> Iterator[str]:
    """Coverage with its 95 % interval, by family of subjects and definition of the volume."""
    groups = {"casts": [one for one in held if one.volume == "model"]}
    for family, women in (("torsos", False), ("women", True)):
        its = [one for one in held if ("woman" in one.subject) == women]
        groups |= {
            family: [one for one in its if one.volume in ("left", "right")],
            f"{family}, left less right": [one for one in its if one.volume == _SIDES],
            f"{family}, as defined": [one for one in its if one.volume.endswith(_AS_DEFINED)],
            f"{family}, to the muscle": [one for one in its if one.volume.endswith(_TO_MUSCLE)],
        }
    groups["all"] = groups["casts"] + groups["torsos"] + groups["women"]
    groups["all, but as defined"] = groups["casts"] + groups["torsos, as defined"] + groups["women, as defined"]
    columns = ("volumes", "number", "held", "95 % of that share", "RMS error / half width", "half width cc", "error cc")
    yield f"| {' | '.join(columns)} |\n" + "| --- " * len(columns) + "|"
    for name, group in groups.items():
        if not group:
            continue
        n, k = len(group), sum(one.holds for one in group)
        low, high = share_interval(k, n)
        relative = np.sqrt(np.mean([(one.error_cc / one.half_cc) ** 2 for one in group]))
        errors, half = np.array([(one.error_cc, one.half_cc) for one in group]).T
        share = f"{100 * k / n:.1f} % | {100 * low:.0f} … {100 * high:.0f} %"
        spread = f"{errors.mean():+.1f} ± {errors.std(ddof=1) if n > 1 else 0.0:.1f}"
        yield f"| {name} | {n} | {share} | {relative:.2f} | {np.median(half):.1f} | {spread} |"


def main() -> None:
    """Measure, and print all volumes and the coverage."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--captures", type=int, default=0, help="rendered sessions, casts and torsos in turn")
    parser.add_argument("--surfaces", type=int, default=0, help="torsos, and as many casts, with drawn errors")
    parser.add_argument("--families", nargs="+", default=["torso"], choices=("torso", *FAMILIES))
    parser.add_argument("--first", type=int, default=1, help="number of the first one, of either")
    parser.add_argument("--scale", type=float, default=0.25, help="of the captures' pictures")
    parser.add_argument("--out", type=Path, default=Path("build/coverage"))
    parser.add_argument("--scheduler", help="of a Dask cluster that sees the folder; default: this machine")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    held = []
    drawn, photographed = (
        surfaces(arguments.surfaces, arguments.first, families=arguments.families),
        rendered(arguments.captures, arguments.out, arguments.scale, arguments.first, arguments.scheduler),
    )
    for one in drawn if arguments.surfaces else photographed:
        sign = "held" if one.holds else "NOT held"
        print(f"{one.subject}: {one.volume} off by {one.error_cc:+.2f} cc, ± {one.half_cc:.2f} cc, {sign}", flush=True)
        held.append(one)
    print("\n".join(summary(held)))
    if arguments.first <= CHOSEN_ON < arguments.captures:
        unseen = [one for one in held if int(one.subject.partition("-")[0]) > CHOSEN_ON]
        print(f"\nof these the captures from {CHOSEN_ON + 1} on, on which no skin's constant was chosen:")
        print("\n".join(summary(unseen)))


if __name__ == "__main__":
    from benchmarks.accuracy import coverage  # under its own name, by which other processes find what it hands them

    coverage.main()
