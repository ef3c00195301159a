"""Simulated patients as a clinic photographs them: what is measured, refused, and silently wrong.

    python -m benchmarks.accuracy.clinic --seeds 1-12 --difficulty 1,2 --out build/clinic
    python -m benchmarks.accuracy.clinic --disturb rail band pale-wall drift=0.02 --subjects torso_3 --out build/clinic
    python -m benchmarks.accuracy.clinic --held-out --seeds 1-90 --difficulty 1,2,3 --out build/clinic

Every capture is simulated, measured from its photographs alone, and compared with its truth. --seeds draws patients
and everything about them: women and operated torsos, before one of several rigs. --disturb takes one body, and measures
it without what was disturbed, too (only patients' and skins' disturbances belong to it). Both surfaces are judged at
the same points of the true one: those that some pair saw past what stood before it. `--out` keeps the sessions: what is
there is not simulated again, but measured again where the code has changed. Seeds that are held out (`draw`) are
skipped without `--held-out`; with it they alone are measured.

A silent error is a volume that its interval does not hold, of whatever size, and a volume where there is no breast.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy.captures import settings_for, take_over_calibration
from benchmarks.road import each_as_it_ends
from mammometry.api.job import Job, open_session
from mammometry.api.truth import current_results
from mammometry.base.errors import MammometryError
from mammometry.base.progress import StageProgress
from mammometry.geometry.arrays import Array, Bool
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.io.meshes.own import read_ply
from mammometry.io.truth import read_truth
from mammometry.job.stages.measure import measurements
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.simulate.disturbances.draw import draw, is_held_out
from mammometry.simulate.disturbances.registry import DISTURBANCES, check
from mammometry.simulate.recipe import SessionRecipe, Situation, parse_situation
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.rigs.build import FULL_SIZE_WH
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio
from mammometry.study.accuracy import SurfaceAccuracy, compare_surfaces
from mammometry.study.evaluation import Truth
from mammometry.study.rays import RayScene, seen_by_pairs

_STUDIO = Studio(skin=make_skin("skin"))
_POINTS = 40_000
"""True vertices at which a surface is judged, at most."""
_REMOVAL = ("removed", "scar", "loose-skin")
"""What a body with both breasts has not."""
_RIGS = ("reference", "reference", "arc", "row")
_BODIES = ("torso", "torso", "torso", "torso", "woman", "leaning-woman", "woman-wide", "leaning-woman-wide")
"""Of drawn patients; only torsos are operated on."""
_CAMERAS = 8
"""Of the reference rig."""
_LONG = 100
"""Characters of a situation that stand in its folder's name."""
_SENTENCE = 240
"""Characters of a refusal that the table shows."""
_MOUNTED = {"upside-down": "upside-down", "portrait-left": "left", "portrait-right": "right"}
"""Size of the disturbance `mounted` → what session.toml says of it."""
_VOLUME_GOAL_PERCENT, _SURFACE_GOAL = 1.0, 1.2
"""Of a disturbance that hides no skin, against the same body without it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One capture that is wanted."""

    recipe: SessionRecipe
    situation: Situation
    drawn: bool = False
    """Whether the patient was drawn, and is compared with the truth alone."""
    mounting_said: bool = False
    """Whether session.toml says how the cameras are mounted, where they are not upright."""

    @property
    def name(self) -> str:
        """Of its folder."""
        said = "-said" if self.mounting_said and "mounted" in str(self.situation) else ""
        return f"{self.recipe.subject}-{self.recipe.seed}-{self.recipe.scale:g}-{self.words}{said}"

    @property
    def words(self) -> str:
        """What disturbs it, as short as a folder's name must be."""
        words = str(self.situation).replace(",", "+") or "clean"
        return words if len(words) <= _LONG else f"{words[:_LONG]}-{zlib.crc32(words.encode()):08x}"

    @property
    def undisturbed(self) -> Case:
        """The same body with nothing about it, before cameras that are still; or, if only it is changed, whole."""
        if self.drawn:
            return self
        there = {one.name for one in self.situation.disturbances}
        added = {name for name in there if DISTURBANCES[name].stage in ("thing", "shoot")}
        return replace(self, situation=self.situation.without(added or _REMOVAL))


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One volume against the truth."""

    name: str
    true_cc: float
    """0 where there is no breast."""
    measured_cc: float | None
    """None where none was measured."""
    interval_cc: tuple[float, float] | None

    @property
    def error_cc(self) -> float | None:
        """Measured less true."""
        return None if self.measured_cc is None else self.measured_cc - self.true_cc

    @property
    def held(self) -> bool | None:
        """Whether the interval holds the truth; None where nothing was measured."""
        if self.measured_cc is None:
            return None
        return self.interval_cc is not None and self.interval_cc[0] <= self.true_cc <= self.interval_cc[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What became of one capture."""

    case: Case
    sides: tuple[Side, ...]
    refused: str
    """The sentence; empty where it was measured."""


def cases(arguments: argparse.Namespace) -> Iterator[Case]:
    """Yield what the command line asks for."""
    for subject in arguments.subjects if arguments.disturb else ():
        for text in DISTURBANCES if arguments.disturb == ["each"] else arguments.disturb:
            if text.partition("=")[0] == "skin":  # it is what the others are compared on
                continue
            situation = _situation(f"skin={arguments.skin},{text}")
            case = _case(subject, arguments.seed, arguments.scale, situation)
            yield replace(case, mounting_said=arguments.mounting_said)
    for seed in arguments.seeds:
        if is_held_out(seed) == arguments.held_out:
            for difficulty in arguments.difficulty:
                patient = _patient(seed, arguments.scale, draw(seed, difficulty))
                yield replace(patient, mounting_said=arguments.mounting_said)


def _situation(text: str) -> Situation:
    try:
        situation = parse_situation(text)
        check(situation, without="walk")
    except ValueError as error:
        raise SystemExit(str(error)) from None
    return situation


def _case(subject: str, seed: int, scale: float, situation: Situation) -> Case:
    return Case(recipe=SessionRecipe(subject=subject, seed=seed, scale=scale, situation=situation), situation=situation)


def _patient(seed: int, scale: float, situation: Situation) -> Case:
    rng = np.random.default_rng([seed, 98])
    rig, body = str(rng.choice(_RIGS)), str(rng.choice(_BODIES))
    if body != "torso":
        situation = situation.without({name for name, kind in DISTURBANCES.items() if kind.stage == "patient"})
        body = f"{body}_{seed}"
    case = _case(body, seed, scale, situation)
    rig = rig if rig == "reference" else str(Path(__file__).parent / "rigs" / f"{rig}.toml")
    return replace(case, drawn=True, recipe=replace(case.recipe, rig=rig))


def both(progress: StageProgress, case: Case, out: str) -> dict[str, Any]:
    """Measure a capture, and the same body without the disturbance, as JSON: a task of a batch."""
    progress("without the disturbance", 0.0)
    before = case.undisturbed
    plain, plain_job = measured(before, Path(out)) if before.name != case.name else (None, None)
    progress("measure", 0.5)
    found, job = measured(case, Path(out))
    surfaces = [_surface(job, job), None if plain_job is None else _surface(plain_job, job)]
    with_it, without = surfaces
    return {
        "found": {"refused": found.refused, "sides": [asdict(side) for side in found.sides]},
        "plain": None if plain is None else {"refused": plain.refused, "sides": [asdict(side) for side in plain.sides]},
        "row": row(found, surfaces),
        "ratios": None
        if with_it is None or without is None
        else (with_it.median_mm / without.median_mm, with_it.rms_mm / without.rms_mm),
    }


def _read(case: Case, data: dict[str, Any]) -> Found:
    sides = []
    for side in data["sides"]:
        interval = side["interval_cc"]
        sides.append(Side(**side | {"interval_cc": None if interval is None else (interval[0], interval[1])}))
    return Found(case=case, sides=tuple(sides), refused=data["refused"])


def measured(case: Case, out: Path) -> tuple[Found, Job]:
    """Simulate a capture if it is not there, measure it, and compare its volumes with their truth."""
    session = out / case.name
    if not (session / "session.toml").is_file():
        shutil.rmtree(session, ignore_errors=True)
        recipe = replace(case.recipe, situation=case.situation)
        write_session(session, recipe, _STUDIO)
        if case.mounting_said:
            _say_mounting(session / "session.toml", case.situation)
        plain = out / case.undisturbed.name
        if plain != session and _same_calibration(session, plain):
            take_over_calibration(session, plain)
    job = open_session(session, settings_for(case.recipe.scale))
    refused = ""
    volumes: dict[str, VolumeMeasurement] = {}
    with threadpool_limits(limits=1, user_api="blas"):
        try:
            job.ensure("measure", drawn=False)
            volumes |= {one.name: one for one in job.plan.value(measurements) or ()}
        except MammometryError as error:
            refused = " ".join(str(error).split())
    truth = read_truth(session / "truth", job.inputs.pair_names)
    return Found(case=case, sides=_sides(truth, volumes), refused=refused), job


def _say_mounting(manifest: Path, situation: Situation) -> None:
    for one in situation.disturbances:
        if one.name == "mounted":
            how = _MOUNTED[str(DISTURBANCES[one.name].sized(one))]
            text = manifest.read_text(encoding="utf-8")
            manifest.write_text(text.replace("[rig]\n", f'[rig]\nmounting = "{how}"\n'), encoding="utf-8")


def _same_calibration(session: Path, other: Path) -> bool:
    """Whether two sessions have the same photographs of the target, and the other one is calibrated by them."""
    files = [path.relative_to(session) for path in sorted((session / "calibration").rglob("*")) if path.is_file()]
    return (other / "results" / "calibrate").is_dir() and all(
        (other / file).is_file() and (other / file).read_bytes() == (session / file).read_bytes() for file in files
    )


def _sides(truth: Truth, volumes: dict[str, VolumeMeasurement]) -> tuple[Side, ...]:
    names = sorted({*truth.volumes_cc, *volumes})
    sides = []
    for name in names:
        found = volumes.get(name)
        sides.append(
            Side(
                name=name,
                true_cc=truth.volumes_cc.get(name, 0.0),
                measured_cc=None if found is None else found.volume_cc,
                interval_cc=None if found is None else found.interval_cc,
            )
        )
    return tuple(sides)


def _surface(job: Job, seen_past: Job) -> SurfaceAccuracy | None:
    """The last surface against the truth, in the frame of the first pose's target, where some pair sees the skin."""
    folder = seen_past.session.path / "truth"
    try:
        results = current_results(job)
    except MammometryError:
        return None
    if not results.surfaces:
        return None
    truth = read_truth(job.session.path / "truth", job.inputs.pair_names)
    world = next(
        (pose for pose, at in results.world_from_target.items() if np.allclose(at.matrix, np.eye(4), atol=1e-9)), None
    )
    if world is None:
        return None
    rig_from_world: Transform = truth.rig_from_target[world]
    other = read_truth(folder, job.inputs.pair_names)
    if not np.array_equal(other.mesh.faces, truth.mesh.faces):  # another body
        other, folder = truth, job.session.path / "truth"
    at = np.flatnonzero(seen(other, folder))
    at = at[:: max(1, len(at) // _POINTS)]
    mesh = list(results.surfaces.values())[-1]
    return compare_surfaces(mesh, truth.mesh, at=at, truth_from_measured=rig_from_world)


def seen(truth: Truth, folder: Path) -> Bool[Array, " n"]:
    """Vertices of the true skin that some pair sees past whatever stands before it."""
    things, count = folder / "things.ply", len(truth.mesh.vertices)
    mesh = truth.mesh
    if things.is_file():
        other = read_ply(things)[0]
        mesh = TriangleMesh(
            vertices=np.concatenate([mesh.vertices, other.vertices]),
            faces=np.concatenate([mesh.faces, other.faces + np.int32(count)]),
        )
    by_pair = seen_by_pairs(RayScene(mesh), truth.rig)[1]
    either: Bool[Array, " n"] = np.any(list(by_pair.values()), axis=0)[:count]
    return either


def row(found: Found, surfaces: Sequence[SurfaceAccuracy | None]) -> str:
    """One line of the table; `surfaces` are its own, and that of the same body without the disturbance."""
    sides = []
    for side in found.sides:
        true = f"{side.name} {side.true_cc:.0f}" if side.true_cc else f"no {side.name}"
        if side.measured_cc is None:
            sides.append(f"{true}: none")
            continue
        assert side.error_cc is not None
        share = f", {100 * side.error_cc / side.true_cc:+.1f} %" if side.true_cc else ""
        sides.append(f"{true}: {side.error_cc:+.1f} cc{share}{'' if side.held else ', **NOT held**'}")
    shown = " | ".join("–" if one is None else _figures(one) for one in surfaces)
    said = found.refused[:_SENTENCE] if found.refused else "measured"
    case = found.case
    capture = f"{case.recipe.subject}, seed {case.recipe.seed}, {Path(case.recipe.rig).stem}: {case.situation}"
    return f"| {capture} | {said} | {'; '.join(sides)} | {shown} |"


def _figures(surface: SurfaceAccuracy) -> str:
    return f"{surface.median_mm:.3f} {surface.rms_mm:.2f} {surface.p95_mm:.2f}, {surface.bias_mm:+.2f}"


HEAD = (
    "| capture | refused or measured | volumes: true, error | surface seen, mm: median RMS 95 %, bias "
    "| without the disturbance |\n| --- | --- | --- | --- | --- |"
)


def summary(all_found: Sequence[tuple[Found, Found | None]], ratios: Sequence[tuple[float, float]]) -> Iterator[str]:
    """Yield the lines of a table of the goals and what was reached.

    `ratios`: of a surface's error with the disturbance to that without, in the median and RMS.
    """
    captures = [found for found, _ in all_found]
    answered = [found for found in captures if not found.refused]
    volumes = [side for found in answered for side in found.sides if side.measured_cc is not None]
    breasts = [side for found in answered for side in found.sides if side.true_cc]
    yield f"| {len(captures)} captures | found | goal |\n| --- | --- | --- |"
    yield f"| refused | {_share(len(captures) - len(answered), len(captures))} | at most 5 % |"
    without = _share(sum(side.held is None for side in breasts), len(breasts))
    yield f"| breasts of the other captures without a volume | {without} | |"
    silent = [side for side in volumes if not (side.held and side.true_cc)]
    yield f"| volumes outside their interval | {_share(len(silent), len(volumes))} | at most 2 % |"
    yield f"| volumes claimed where there is no breast | {sum(not side.true_cc for side in volumes)} | 0 |"
    errors = sorted(abs(side.error_cc or 0.0) / side.true_cc for side in volumes if side.true_cc)
    if errors:
        middle, most = 100 * errors[len(errors) // 2], 100 * errors[-1]
        yield f"| error of a volume, median and worst | {middle:.1f} %, {most:.1f} % | |"
    pairs = [(found, plain) for found, plain in all_found if plain is not None]
    if pairs:
        alone = sum(bool(found.refused and not plain.refused) for found, plain in pairs)
        yield f"| refused where the same body without the disturbance is measured | {_share(alone, len(pairs))} | 0 |"
    changes = []
    for found, plain in pairs:
        before = {side.name: side.measured_cc for side in plain.sides if side.measured_cc}
        changes += [
            100 * (side.measured_cc / before[side.name] - 1)
            for side in found.sides
            if side.measured_cc is not None and side.name in before
        ]
    if changes:
        share = _share(sum(abs(change) <= _VOLUME_GOAL_PERCENT for change in changes), len(changes))
        what = "volumes within 1 % of the same body's without the disturbance"
        yield f"| {what} | {share}, worst {max(changes, key=abs):+.1f} % | all |"
    for word, each in zip(("median", "RMS"), zip(*ratios, strict=True), strict=False):
        share = _share(sum(ratio <= _SURFACE_GOAL for ratio in each), len(each))
        yield f"| surfaces with at most 1.2 times the error ({word}) | {share}, worst {max(each):.1f} | all |"


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole}" + (f" ({100 * part / whole:.0f} %)" if whole else "")


def _numbers(text: str) -> list[int]:
    """Read ``1-12`` or ``1,3,5``."""
    found: list[int] = []
    for part in filter(None, text.split(",")):
        low, _, high = part.partition("-")
        found += range(int(low), int(high or low) + 1)
    return found


def main() -> None:
    """Simulate, measure, and print what was reached; each capture as it ends on standard error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=_numbers, default=[], help="of drawn situations: 1-12, or 1,3,4")
    parser.add_argument("--difficulty", type=_numbers, default=[1], help="of drawn situations, 0 to 3: 1,2")
    parser.add_argument("--held-out", action="store_true", help="measure the held-out seeds, and no others")
    parser.add_argument(
        "--disturb", nargs="+", default=[], help="situations to measure one by one: rail drift=0.02; or each"
    )
    parser.add_argument("--subjects", nargs="+", default=["torso_3"], help="for --disturb")
    parser.add_argument("--seed", type=int, default=7, help="for --disturb")
    parser.add_argument("--skin", default="skin", help="for --disturb")
    parser.add_argument("--mounting-said", action="store_true", help="with mounted=…: session.toml says it")
    parser.add_argument("--scale", type=float, default=0.25, help="of the pictures")
    parser.add_argument("--out", type=Path, default=Path("build/clinic"))
    parser.add_argument("--scheduler", help="of a Dask cluster that sees the folder; default: this machine")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    wanted = {case.name: case for case in cases(arguments)}
    plain = {case.undisturbed.name: case.undisturbed for case in wanted.values()}
    print(HEAD, file=sys.stderr, flush=True)
    all_found: list[tuple[Found, Found | None]] = []
    ratios = []
    # First each body alone, once: what is compared with it finds it measured.
    for there in (plain, {name: case for name, case in wanted.items() if name not in plain}):
        tasks = {name: (case, str(arguments.out.absolute())) for name, case in there.items()}
        width, height = FULL_SIZE_WH
        megapixels = _CAMERAS * width * height * arguments.scale**2 / 1e6
        for name, done in each_as_it_ends(both, tasks, megapixels=megapixels, scheduler=arguments.scheduler):
            if name not in wanted:
                continue
            case = wanted[name]
            print(done["row"], file=sys.stderr, flush=True)
            if done["ratios"] is not None:
                ratios.append(tuple(done["ratios"]))
            before = None if done["plain"] is None else _read(case.undisturbed, done["plain"])
            all_found.append((_read(case, done["found"]), before))
    print("\n".join(summary(all_found, ratios)))
    table = [
        {"capture": found.case.name, "refused": found.refused, "sides": [asdict(side) for side in found.sides]}
        for found, _ in all_found
    ]
    (arguments.out / "clinic.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    from benchmarks.accuracy import clinic  # under its own name, by which other processes find what it hands them

    clinic.main()
