"""Check by the calibration that a visit's photographs have the names of their cameras."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from mammometry.api.job import open_session
from mammometry.base.errors import CalibrationError, MammometryError
from mammometry.base.photograph import Photograph
from mammometry.calibration.features.keypoints import Keypoints, keypoints
from mammometry.calibration.judge.cameras.names import check_names, wrong_photographs
from mammometry.capture.checks.found import Found
from mammometry.clinic.models import Visit
from mammometry.clinic.site import the_clinic
from mammometry.geometry.camera import Rig
from mammometry.io.photographs.images import read_photograph
from mammometry.job.stages import calibrate

_KEPT = 64  # photographs whose features are kept, half a megabyte each: those of the visits that are being entered
_features: dict[str, Keypoints] = {}


def note(sha256: str, photograph: Photograph) -> None:
    """Keep the features of a photograph that is decoded anyway."""
    _features[sha256] = keypoints(photograph)
    for old in list(_features)[:-_KEPT]:
        _features.pop(old, None)


def check(visit: Visit, photographs: tuple[tuple[str, str, Path], ...]) -> list[Found]:
    """Say which photographs are exchanged, or do not belong to the others.

    Args:
        visit: with its calibration, if it has one.
        photographs: camera, digest and place of each.
    """
    calibration = visit.calibration
    if calibration is None or not calibration.figures:
        return []
    return list(_checked(str(the_clinic().folder / calibration.folder), photographs))


@lru_cache(maxsize=32)
def _checked(calibration: str, photographs: tuple[tuple[str, str, Path], ...]) -> tuple[Found, ...]:
    try:
        rig = _rig(calibration)
        seen = {camera: _seen(sha256, path) for camera, sha256, path in photographs if camera in rig.cameras}
    except MammometryError:  # the job says what is wrong with the calibration, or with a photograph
        return ()
    names = check_names(rig, seen)
    wrong = wrong_photographs(names, rig.pair_names)
    found = [
        Found(check="names", level="refuse", sentence=f"{mismatch.listed}: {mismatch.found}. {mismatch.remedy}.")
        for mismatch in wrong
    ]
    if names.unknown and not found:
        pairs = ", ".join(names.unknown)
        sentence = f"Too little texture to tell whether the photographs of pair {pairs} belong to their cameras."
        found.append(Found(check="names", level="unknown", sentence=sentence))
    return tuple(found)


@lru_cache(maxsize=8)
def _rig(calibration: str) -> Rig:
    job = open_session(calibration, the_clinic().measuring())
    if not job.store.has(job.plan[calibrate.cameras].key):  # to be made again, by a job and not while a page waits
        raise CalibrationError(
            calibration, found="no result that is current", expected="one", remedy="Calibrate the rig again"
        )
    return job.calibrate().rig


def _seen(sha256: str, path: Path) -> Keypoints:
    if sha256 not in _features:
        note(sha256, read_photograph(path, path.name))
    return _features[sha256]
