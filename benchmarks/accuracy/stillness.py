"""Cameras that turned, and pairs exposed while the body moved: what becomes of surface and volume.

    python -m benchmarks.accuracy.stillness CAPTURES [--subject plaster_b] [--seeds 2] [--cube-mm 1.0]

CAPTURES is a folder laid out as ../shared/data/rendered, or a session of `mammometry simulate`. The photographs stay as
they are, and the calibrated cameras are disturbed instead: that is the same, but for the frame of the world. A turn is
about a random axis, of a random size up to the one that is named. A shift carries each pair along in a random order,
the first by nothing and the last by all of it, as if the body had moved between the exposures at an even speed. Each
disturbed capture is matched once and measured twice, put right and not. Surfaces are aligned with the truth before they
are compared; volumes are compared with the truth and with those of the undisturbed capture. A torso's interval before
its named wall is asked for the latter.

A disturbance matters where it changes, not put right, a volume by more than 1 % or the surface by .3 mm (RMS).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from benchmarks.accuracy.coverage import share_interval
from benchmarks.pairs import Capture, captures
from mammometry.api.job import Job, open_session
from mammometry.base.errors import MammometryError
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.arrays import Array, Int64
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.io.truth import read_truth
from mammometry.job.graph import Plan
from mammometry.job.method import method
from mammometry.job.products import Given, Key, at_hand
from mammometry.job.stages import calibrate, match, measure, surface
from mammometry.settings import Settings
from mammometry.study.accuracy import align_surfaces, compare_surfaces
from mammometry.study.evaluation import Truth
from mammometry.study.rays import RayScene, seen_by_pairs

T = TypeVar("T")
_EVERY = 20  # true vertices of which one is judged
DISTURBANCES = ((0.0, 0.0), (0.005, 0.0), (0.01, 0.0), (0.02, 0.0), (0.05, 0.0), (0.0, 0.3), (0.0, 1.0), (0.02, 0.3))
"""Largest turn of a camera, degrees, and motion of the body over all exposures, mm. .3 mm is what a body that sways and
breathes moves in 20 ms."""
_MATTERS_PERCENT, _MATTERS_MM = 1.0, 0.3  # of a volume, and of the surface: issue 18


class _MatchedOnce:
    """Remembers in memory what the matching makes, which both ways to measure share."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}

    def has(self, key: Key) -> bool:
        return key.digest in self._values

    def recall(self, key: Key, prepare: Callable[[], Callable[[Progress], T]]) -> T:
        if key.stage != "match":
            return prepare()(no_progress)
        if key.digest not in self._values:
            self._values[key.digest] = prepare()(no_progress)
        value: T = self._values[key.digest]
        return value


def disturbed(rig: Rig, turn_deg: float, shift_mm: float, random: np.random.Generator) -> Rig:
    """Turn every camera about its centre, and carry pairs along."""
    cameras = {name: _turned(camera, turn_deg, random) for name, camera in rig.cameras.items()}
    towards = np.mean([camera.axis_world for camera in rig.cameras.values()], axis=0)
    towards /= np.linalg.norm(towards)
    shares = random.permutation(np.linspace(0.0, 1.0, len(rig.pair_names)))
    for share, names in zip(shares, rig.pair_names.values(), strict=True):
        along = Transform(rotation=np.eye(3), translation_mm=share * shift_mm * towards)
        for name in names:
            pose = cameras[name].camera_from_world @ along.inverse()
            cameras[name] = replace(cameras[name], camera_from_world=pose)
    return replace(rig, cameras=cameras)


def _turned(camera: Camera, turn_deg: float, random: np.random.Generator) -> Camera:
    axis = random.normal(size=3)
    turn = np.radians(turn_deg) * random.uniform() * axis / np.linalg.norm(axis)
    by = Transform.from_rotation_vector(turn, np.zeros(3))
    rotation = by.rotation @ camera.camera_from_world.rotation
    return replace(
        camera, camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ camera.centre_world)
    )


@dataclass(frozen=True)
class Judge:
    """The truth of a capture, and what of it can be seen."""

    truth: Truth
    truth_from_world: Transform
    seen: Int64[Array, " k"]


def judge_of(capture: Capture, job: Job) -> Judge:
    """Read a capture's truth, in the frame of its calibration."""
    truth = read_truth(capture.truth, job.inputs.pair_names)
    world_from_target = job.plan[calibrate.calibration]().world_from_target
    pose = next(name for name, placed in world_from_target.items() if np.allclose(placed.matrix, np.eye(4)))
    looked_at, by_pair = seen_by_pairs(RayScene(truth.mesh), truth.rig, every=_EVERY)
    seen = looked_at[np.any(list(by_pair.values()), axis=0)]
    return Judge(truth=truth, truth_from_world=truth.rig_from_target[pose], seen=seen)


def measured(job: Job, rig: Rig, settings: Settings, judge: Judge) -> Iterator[dict[str, Any]]:
    """Match with a rig, then measure with and without putting right what moved; one row each."""
    calibration, cameras = job.plan[calibrate.calibration](), job.plan[calibrate.cameras]()
    given: Given = {
        product: at_hand(replace(value, rig=rig), stage="calibrate", name=product.name, version=0, inputs={})
        for product, value in ((calibrate.calibration, calibration), (calibrate.cameras, cameras))
    }
    memo = _MatchedOnce()
    for correct in (True, False):
        plan = Plan(method, job.inputs, settings, memo, given=given)
        for disparity in plan[match.disparity].values():
            disparity()  # what it refuses is an error here
        row: dict[str, Any] = {"put right": correct}
        try:
            found = plan[surface.stillness]()
            if not correct:
                left = at_hand(replace(found, corrected=False), stage="surface", name="stillness", version=0, inputs={})
                plan = Plan(method, job.inputs, settings, memo, given={**given, surface.stillness: left})
            repaired = plan[surface.repaired]()
            measurements = plan[measure.measurements]()
        except MammometryError as error:
            yield row | {"refused": str(error)}
            continue
        world = repaired.mesh.transformed(judge.truth_from_world)
        placed = align_surfaces(world, judge.truth.mesh, judge.seen)
        errors = compare_surfaces(world, judge.truth.mesh, at=judge.seen, truth_from_measured=placed)
        yield row | {
            "noticed": found.moved,
            "apart": found.distance_mm,
            "evidence": found.evidence,
            "rest_mm": found.rest_mm,
            "pairs": {each.pair: (each.effect_mm, each.std_mm) for each in found.displaced},
            "turns": {each.camera: (each.turn_deg, each.std_deg) for each in found.turns},
            "bias_mm": errors.bias_mm,
            "rms_mm": errors.rms_mm,
            "true_cc": dict(judge.truth.volumes_cc),
            "volumes_cc": {each.name: each.volume_cc for each in measurements},
            "intervals_cc": {each.name: each.interval_cc for each in measurements},
            "held_by_cc": {each.name: each.as_defined_cc or each.interval_cc for each in measurements},
            "movement_cc": {each.name: each.interval_terms_cc.get("movement", 0.0) for each in measurements},
        }
        if not found.moved:
            return  # nothing is put right: both are the same


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one line a measurement."""
    clean = {row["subject"]: row["volumes_cc"] for row in rows if not (row["turn_deg"] or row["shift_mm"])}
    lines = [
        "| subject | turn ° | shift mm | seed | noticed | put right | apart mm | surface bias | RMS mm | volume from "
        "clean % | movement ± cc | clean held | truth held |",
        "| " + " | ".join(["---"] * 13) + " |",
    ]
    for row in rows:
        head = f"| {row['subject']} | {row['turn_deg']:g} | {row['shift_mm']:g} | {row['seed']} |"
        if "refused" in row:
            lines.append(f"{head} refused | {row['put right']} | | | | | | | |")
            continue
        before = clean[row["subject"]]
        changed = [f"{100 * (cc / before[name] - 1):+.2f}" for name, cc in row["volumes_cc"].items()]
        held, true = _held(row, "held_by_cc", before), _held(row, "intervals_cc", row["true_cc"])
        lines.append(
            f"{head} {'yes' if row['noticed'] else 'no'} | {'yes' if row['put right'] and row['noticed'] else 'no'} | "
            f"{row['apart'][0]:.3f} → {row['apart'][1]:.3f} | {row['bias_mm']:+.3f} | {row['rms_mm']:.3f} | "
            f"{' '.join(changed)} | {' '.join(f'{cc:.1f}' for cc in row['movement_cc'].values())} | "
            f"{' '.join('yes' if each else 'NO' for each in held)} | "
            f"{' '.join('yes' if each else 'NO' for each in true)} |"
        )
    return "\n".join(lines)


def _held(row: dict[str, Any], intervals: str, of_cc: dict[str, float]) -> list[bool]:
    return [low <= of_cc[name] <= high for name, (low, high) in row[intervals].items()]


def summary(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield how often each disturbance is noticed, and how often the intervals hold; one line a disturbance."""
    clean = {row["subject"]: row for row in rows if not (row["turn_deg"] or row["shift_mm"])}
    columns = (
        "turn up to °, body moved mm",
        "put right",
        "captures",
        "refused",
        "it matters",
        "noticed, of those",
        "noticed, of the others",
        "truth held",
        "95 % of that share",
        "clean held",
        "clean within the movement's term",
        "volume from clean %: mean ± SD, worst",
        "surface RMS mm",
    )
    yield f"| {' | '.join(columns)} |\n" + "| --- " * len(columns) + "|"
    by_capture: dict[tuple[Any, ...], dict[bool, dict[str, Any]]] = {}
    for row in rows:
        key = (row["turn_deg"], row["shift_mm"], row["subject"], row["seed"])
        by_capture.setdefault(key, {})[row["put right"]] = row
    for size in sorted({key[:2] for key in by_capture}):
        both = [each for key, each in by_capture.items() if key[:2] == size]
        left = [each.get(False, each[True]) for each in both]
        matters = [_matters(row, clean[row["subject"]]) for row in left]
        noticed = [bool(each[True].get("noticed", True)) for each in both]  # refused: noticed
        for put_right, chosen in ((True, [each[True] for each in both]), (False, left)):
            measured_rows = [row for row in chosen if "refused" not in row]
            true = [one for row in measured_rows for one in _held(row, "intervals_cc", row["true_cc"])]
            same = [
                one for row in measured_rows for one in _held(row, "held_by_cc", clean[row["subject"]]["volumes_cc"])
            ]
            by_term = [one for row in measured_rows for one in _within_movement(row, clean[row["subject"]])]
            changes = np.array([one for row in measured_rows for one in _changes(row, clean[row["subject"]])])
            rms = [row["rms_mm"] for row in measured_rows]
            low, high = share_interval(sum(true), len(true))
            counts = (
                f"{sum(n for n, m in zip(noticed, matters, strict=True) if m)} of {sum(matters)} | "
                f"{sum(n for n, m in zip(noticed, matters, strict=True) if not m)} of {len(both) - sum(matters)}"
            )
            yield (
                f"| {size[0]:g}, {size[1]:g} | {'yes' if put_right else 'no'} | {len(both)} | "
                f"{len(both) - len(measured_rows)} | {sum(matters)} | {counts} | {sum(true)} of {len(true)} | "
                f"{100 * low:.0f} … {100 * high:.0f} % | {sum(same)} of {len(same)} | "
                f"{sum(by_term)} of {len(by_term)} | {_spread(changes)} | {f'{np.median(rms):.3f}' if rms else '–'} |"
            )


def _spread(changes: Array) -> str:
    """Mean, scatter and largest of the changes, %; a dash where every capture was refused."""
    if not len(changes):
        return "–"
    return f"{changes.mean():+.2f} ± {changes.std():.2f}, {changes[np.argmax(np.abs(changes))]:+.2f}"


def _within_movement(row: dict[str, Any], clean: dict[str, Any]) -> list[bool]:
    """Whether the term that a motion adds to the interval holds alone what the motion did, where one was noticed."""
    if not row["noticed"]:
        return []
    return [abs(cc - clean["volumes_cc"][name]) <= row["movement_cc"][name] for name, cc in row["volumes_cc"].items()]


def _changes(row: dict[str, Any], clean: dict[str, Any]) -> list[float]:
    """Volumes against those of the undisturbed capture, %."""
    return [100 * (cc / clean["volumes_cc"][name] - 1) for name, cc in row["volumes_cc"].items()]


def _matters(row: dict[str, Any], clean: dict[str, Any]) -> bool:
    """Whether a disturbance that was not put right changes what is said."""
    if "refused" in row:
        return True
    added_mm = np.sqrt(max(0.0, row["rms_mm"] ** 2 - clean["rms_mm"] ** 2))
    return bool(max(map(abs, _changes(row, clean))) > _MATTERS_PERCENT or added_mm > _MATTERS_MM)


def main() -> None:
    """Parse the arguments, disturb and measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path, help="captures of the independent renderer, or a simulated session")
    parser.add_argument("--subject", action="append", default=[], help="one subject; may be repeated; default: all")
    parser.add_argument("--seeds", type=int, default=2, help="of each disturbance")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="*", choices=range(len(DISTURBANCES)), help="default: all")
    parser.add_argument("--cube-mm", type=float, default=1.0)
    parser.add_argument("--scratch", type=Path, help="where sessions are made and their calibrations kept")
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--resume", action="store_true", help="keep what the JSON file has")
    arguments = parser.parse_args()
    settings = Settings().overridden([f"surface.extract.cube_mm={arguments.cube_mm}"])
    chosen = [DISTURBANCES[number] for number in arguments.only or range(len(DISTURBANCES))]
    rows: list[dict[str, Any]] = json.loads(arguments.json.read_text()) if arguments.resume else []
    done = {(row["subject"], row["turn_deg"], row["shift_mm"], row["seed"]) for row in rows}
    with tempfile.TemporaryDirectory() as scratch:
        for capture in captures(arguments.captures, arguments.subject, arguments.scratch or Path(scratch)):
            job = open_session(capture.session, settings)
            with job.store.taken():
                job.plan.ensure("calibrate")
                judge, rig = judge_of(capture, job), job.plan[calibrate.cameras]().rig
                for turn_deg, shift_mm in chosen:
                    last = arguments.first_seed + (arguments.seeds if turn_deg or shift_mm else 1)
                    for seed in range(arguments.first_seed, last):
                        if (capture.name, turn_deg, shift_mm, seed) in done:
                            continue
                        there = disturbed(rig, turn_deg, shift_mm, np.random.default_rng(seed))
                        said = {"subject": capture.name, "turn_deg": turn_deg, "shift_mm": shift_mm, "seed": seed}
                        for row in measured(job, there, settings, judge):
                            rows.append(said | row)
                            print(table(rows).splitlines()[-1], flush=True)
                            if arguments.json:
                                arguments.json.write_text(json.dumps(rows, indent=1, default=float))
    print(table(rows))
    print()
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
