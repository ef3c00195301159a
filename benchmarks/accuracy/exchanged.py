"""Exchanged photographs, and those of another exposure or rig: named, missed and false refusals.

    python -m benchmarks.accuracy.exchanged CAPTURES [--simulate]

CAPTURES holds sessions of `mammometry simulate`, which --simulate makes where they are not there; the true cameras
stand for calibrated ones, so nothing depends on photographs of the target. Two sessions whose names begin alike are of
one rig. Each is looked at as it is, which must not be refused, and with: every two photographs exchanged; every two
pairs exchanged; each photograph replaced by that of another patient; all photographs of another rig. *named*: just
those photographs are named; *refused*: with other words; *undecided*: it is said that it cannot be told; *missed*:
nothing is said.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from time import perf_counter

from mammometry.calibration.features.keypoints import Keypoints, keypoints, matched
from mammometry.calibration.judge import camera_names as judged_names
from mammometry.calibration.judge.camera_names import PhotographCheck, check_names
from mammometry.geometry.camera import Rig
from mammometry.io.manifest import read_manifest
from mammometry.io.photographs.images import read_photograph
from mammometry.io.truth import read_true_cameras
from mammometry.simulate.disturbances.draw import draw
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio

_RIGS = Path(__file__).parent / "rigs"
_KINDS = ("as it is", "two photographs exchanged", "two pairs exchanged", "of another patient", "of another rig")


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """A simulated capture, as it is looked at."""

    name: str
    rig: Rig
    features: Mapping[str, Keypoints]
    seconds: float
    """To find the features, and to look at the names."""


def simulate(folder: Path) -> None:
    """Make the sessions that are not there."""
    hard = {seed: str(draw(seed, difficulty)) for seed, difficulty in ((16, 2), (17, 3), (20, 3))}
    for name, rig, seed, subject, skin, scale, disturbed in (
        ("reference-torso_1", "reference", 7, "torso_1", "skin", 0.25, ""),
        ("reference-plaster_5", "reference", 7, "plaster_5", "plaster", 0.25, ""),
        ("reference-torso_6", "reference", 7, "torso_6", "sweat", 0.25, "drift=0.02"),
        ("full-torso_7", "reference", 7, "torso_7", "skin", 1.0, ""),
        ("full-plaster_1", "reference", 7, "plaster_1", "plaster", 1.0, ""),
        ("arc-torso_4", str(_RIGS / "arc.toml"), 8, "torso_4", "pale-skin", 0.25, ""),
        ("arc-woman_1", str(_RIGS / "arc.toml"), 8, "woman_1", "dark-skin", 0.25, ""),
        ("ring-plaster_3", str(_RIGS / "ring.toml"), 9, "plaster_3", "plaster", 0.25, ""),
        ("ring-torso_5", str(_RIGS / "ring.toml"), 9, "torso_5", "plaster", 0.25, "removed=right,rail"),
        ("small-torso_2", "reference:front,left,right", 11, "torso_2", "plaster", 0.12, ""),
        ("small-torso_3", "reference:front,left,right", 11, "torso_3", "plaster", 0.12, ""),
        ("row-plaster_7", str(_RIGS / "row.toml"), 12, "plaster_7", "plaster", 0.25, ""),
        ("cross-plaster_2", str(_RIGS / "cross.toml"), 13, "plaster_2", "plaster", 0.25, ""),
        *((f"drawn_{seed}", "reference", seed, "torso", "plaster", 0.25, hard[seed]) for seed in hard),
    ):
        if not (folder / name).exists():
            recipe = SessionRecipe(
                rig=rig, subject=subject, scale=scale, seed=seed, poses=1, situation=parse_situation(disturbed)
            )
            noise = 2.0 if name.startswith("row") else 1.0
            write_session(folder / name, recipe, Studio(skin=make_skin(skin), film=Film().with_noise(noise)))


def read_capture(folder: Path) -> Capture:
    """Read cameras and photographs of a simulated session."""
    pairs = {pair.name: (pair.left, pair.right) for pair in read_manifest(folder / "session.toml").rig.pairs}
    rig = Rig(name=folder.name, cameras=read_true_cameras(folder / "truth"), pair_names=pairs)
    photographs = {name: next((folder / "capture").glob(f"{name}.*")) for name in rig.cameras}
    decoded = {name: read_photograph(path, name) for name, path in photographs.items()}
    begun = perf_counter()
    features = {name: keypoints(photograph) for name, photograph in decoded.items()}
    check_names(rig, features)
    return Capture(name=folder.name, rig=rig, features=features, seconds=perf_counter() - begun)


def judged(rig: Rig, features: Mapping[str, Keypoints], moved: Sequence[str] = (), foreign: str = "") -> str:
    """What comes of a capture in which photographs are exchanged, or one is foreign."""
    names = check_names(rig, features)
    if (moved or foreign) and (set(names.exchanged), set(names.foreign)) == (set(moved), {foreign} - {""}):
        return "named"
    if not names.right:
        return "refused"
    return "undecided" if names.unknown or _moved(names) else "missed"


def _moved(names: PhotographCheck) -> bool:
    return any(pair.moved for pair in names.pairs.values())


def cases(captures: Sequence[Capture]) -> Iterator[tuple[str, str, str]]:
    """Capture, kind, and what came of it."""
    for capture in captures:
        rig, own = capture.rig, capture.features
        names = check_names(rig, own)
        yield capture.name, _KINDS[0], "refused" if not names.right else "undecided" if names.unknown else "right"
        in_pairs = sorted({name for both in rig.pair_names.values() for name in both})
        for one, other in combinations(in_pairs, 2):
            yield capture.name, _KINDS[1], judged(rig, {**own, one: own[other], other: own[one]}, (one, other))
        for one_pair, other_pair in combinations(rig.pair_names.values(), 2):
            both = dict(zip(one_pair + other_pair, other_pair + one_pair, strict=True))
            exchanged = {**own, **{name: own[source] for name, source in both.items()}}
            yield capture.name, _KINDS[2], judged(rig, exchanged, tuple(both))
        for guest in captures:
            if guest is capture:
                continue
            if guest.name.partition("-")[0] == capture.name.partition("-")[0]:
                for name in in_pairs:
                    yield capture.name, _KINDS[3], judged(rig, {**own, name: guest.features[name]}, foreign=name)
            elif guest.rig.cameras.keys() == rig.cameras.keys() and _sizes(rig) == _sizes(guest.rig):
                guests = check_names(rig, guest.features)
                yield capture.name, _KINDS[4], "named" if guests.another_rig else judged(rig, guest.features)


def _sizes(rig: Rig) -> set[tuple[int, int]]:
    return {camera.size_wh for camera in rig.cameras.values()}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path)
    parser.add_argument("--simulate", action="store_true")
    arguments = parser.parse_args()
    if arguments.simulate:
        simulate(arguments.captures)
    setattr(judged_names, "matched", cache(matched))  # noqa: B010  # the same two photographs meet in many cases
    captures = [read_capture(folder) for folder in sorted(arguments.captures.iterdir()) if folder.is_dir()]
    counted: dict[str, Counter[str]] = {kind: Counter() for kind in _KINDS}
    for name, kind, outcome in cases(captures):
        counted[kind][outcome] += 1
        if outcome in ("missed", "refused", "undecided"):
            print(f"{name}: {kind}: {outcome}")
    outcomes = ("right", "named", "refused", "undecided", "missed")
    print(f"| {len(captures)} captures | cases | {' | '.join(outcomes)} |")
    print("| --- " * (2 + len(outcomes)) + "|")
    for kind, counts in counted.items():
        print(f"| {kind} | {counts.total()} | {' | '.join(str(counts[one]) for one in outcomes)} |")
    slowest = max(captures, key=lambda one: one.seconds)
    print(f"features and names: {slowest.seconds:.2f} s at most ({slowest.name}), decoded photographs")


if __name__ == "__main__":
    main()
