"""Rectified pairs of a capture and their truth, with true or calibrated cameras."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.names import known
from benchmarks.rendered import make_session, subjects
from mammometry.api.job import open_session
from mammometry.base.photograph import Photograph
from mammometry.geometry.camera import Rig, StereoPair
from mammometry.io.photographs.images import read_photograph
from mammometry.io.truth import read_truth
from mammometry.matching.foreground.all_cameras import find_subjects
from mammometry.matching.foreground.foreground import Foreground, estimate_foreground
from mammometry.matching.rectify import RectifiedPair, rectify
from mammometry.matching.settings import ForegroundSettings, MatchSettings
from mammometry.study.accuracy_matching import TrueDisparity, true_disparity
from mammometry.study.rays import RayScene


@dataclass(frozen=True)
class Capture:
    """Photographs of one subject, and where its truth lies."""

    name: str
    session: Path
    truth: Path


@dataclass(frozen=True)
class Case:
    """One rectified pair and what is true of it."""

    pair: RectifiedPair
    truth: TrueDisparity
    scene: RayScene
    true_cameras: StereoPair
    photographs: tuple[Photograph, Photograph]
    foregrounds: tuple[Foreground, Foreground]
    prepare_seconds: float
    """To read, find the subject in, and rectify both photographs."""


def captures(folder: Path, chosen: list[str], scratch: Path) -> list[Capture]:
    """The subjects of captures laid out as ../shared/data/rendered, or the one of a session of `mammometry simulate`.

    Args:
        folder: of either kind.
        chosen: names of subjects; none: all.
        scratch: where sessions are made for subjects that are none.
    """
    if not (folder / "session.json").is_file():
        return [Capture(folder.name, folder, folder / "truth")]
    return [
        Capture(name, make_session(folder, name, scratch / name), folder / name / "truth")
        for name in chosen or subjects(folder)
    ]


def calibrated(session: Path) -> Rig:
    """What a session's own calibration photographs give; recalled where the session has it already."""
    return open_session(session).calibrate().rig


def foregrounds_of(
    rig: Rig, photographs: Mapping[str, Photograph], settings: ForegroundSettings = ForegroundSettings()
) -> dict[str, Foreground]:
    """Camera → its foreground, as the product finds it."""
    found = find_subjects(rig, photographs, settings)
    return {name: estimate_foreground(shot, name, subject=found.blocks.get(name)) for name, shot in photographs.items()}


def cases(capture: Capture, pairs: list[str], settings: MatchSettings, rig: Rig | None = None) -> Iterator[Case]:
    """Rectify pairs, all if none is named, by the true cameras or by those of a rig.

    What is true of a photograph's pixel is found through the true cameras and then said in pixels of the pair as the
    rig rectifies it, so that nothing has to be aligned: the rig's frame and scale do not enter.
    """
    names = open_session(capture.session).session.pair_names
    known("pairs", pairs, names)
    truth = read_truth(capture.truth, names)
    scene = RayScene(truth.mesh)
    begun = time.perf_counter()
    cameras = truth.rig if rig is None else rig
    files = {name: next((capture.session / "capture").glob(f"{name}.*")) for name in cameras.cameras}
    photographs = {name: read_photograph(file, name) for name, file in files.items()}
    found = foregrounds_of(cameras, photographs, settings.foreground)
    shared_seconds = (time.perf_counter() - begun) / len(names)
    for name in pairs or names:
        begun = time.perf_counter()
        true, believed = truth.rig.pair(name), cameras.pair(name)
        left, right = photographs[believed.left.name], photographs[believed.right.name]
        foregrounds = found[believed.left.name], found[believed.right.name]
        pair = rectify(believed, left, right, *foregrounds)
        seconds = shared_seconds + time.perf_counter() - begun
        yield Case(
            pair=pair,
            truth=true_disparity(scene, true, believed, pair.left, pair.right),
            scene=scene,
            true_cameras=true,
            photographs=(left, right),
            foregrounds=foregrounds,
            prepare_seconds=seconds,
        )
