"""The computation of a job, in the worker's process.

It runs in a separate process, and uses neither the database nor names.

All results are in the session's folder, under keys derived from their content. If a job is started again because a
machine failed, it finds its earlier results and returns the same answer.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mammometry
from mammometry.api.job import open_session
from mammometry.api.photos import BOARD, WALK, prepare_walk
from mammometry.base.errors import SessionError
from mammometry.base.notices import words_of
from mammometry.base.progress import StageProgress
from mammometry.batch.record import BatchEntry
from mammometry.batch.session import measure_entry, watched
from mammometry.calibration.judge.quality import assess
from mammometry.capture.camera_checks import KnownCamera, clocks
from mammometry.capture.sessions import share_calibration, take_over
from mammometry.clinic.rig_results import check_table
from mammometry.hospital.gather import quantities
from mammometry.io import drift
from mammometry.io.photographs.heic import is_heic
from mammometry.io.photographs.images import EXTENSIONS, read_header
from mammometry.io.photographs.same_pixels import pixels_digest
from mammometry.io.photographs.tags import read_exposure
from mammometry.io.photographs.video_file import is_video
from mammometry.io.session import Session
from mammometry.io.write import disk_errors
from mammometry.job.stages.calibrate import cameras as cameras_product
from mammometry.job.stages.measure import boundaries
from mammometry.measure.volume.attribution import curve_digest
from mammometry.measure.volume.difference import difference
from mammometry.settings import Settings

if TYPE_CHECKING:
    from mammometry.job.graph import Plan
    from mammometry.measure.volume.measurement import VolumeMeasurement

RESULTS = "results"
"""Folder of the results below a visit's folder."""
_WHOLE = "closed solid"
"""Definition of a cast's volume. There is only one."""
_CHANGE_NO_NUMBER = ("compare", "limits")
"""Tables of settings that do not affect a visit's numbers."""
_REFUSED = "any"
"""Definition stored for a side without any volume."""


def measure(progress: StageProgress, session: str, calibration: str, settings: str) -> dict[str, Any]:
    """Measure a visit with its rig's calibration.

    Args:
        progress: called with stage and fraction.
        session: the visit's folder.
        calibration: the folder of the rig's calibration.
        settings: TOML.

    Returns:
        ``digest`` of the results, ``volumes`` as rows, ``curves`` (breast → digest of its boundary), ``quantities``
        as rows of `hospital.exported.Quantity`, ``megapixels``.

    Raises:
        MammometryError: the job cannot be done.
    """
    chosen = Settings.from_toml(settings)
    progress("prepare", 0.0)
    share_calibration(Path(calibration), Path(session))
    job = open_session(session, chosen)
    take_over(job, open_session(calibration, chosen))
    return _measured(progress, session, settings)


def measure_walk(progress: StageProgress, session: str, about: str, settings: str) -> dict[str, Any]:
    """Measure photographs by one telephone and a printed board.

    The session is made from them once. Later jobs use the session instead of the photographs, which are then deleted.

    Args:
        progress: called with stage and fraction.
        session: the visit's folder, which may not exist yet.
        about: JSON with ``files`` in the photographs' order, ``board`` as in board.toml, ``subject`` and ``scratch``.
        settings: TOML.

    Returns:
        As `measure`.

    Raises:
        MammometryError: the job cannot be done.
    """
    progress("prepare", 0.0)
    folder = Path(session)
    if not (folder / WALK).is_file():
        walk = json.loads(about)
        with _numbered(walk["files"], walk["board"], Path(walk["scratch"])) as photographs:
            prepare_walk(
                photographs, folder, posture="unknown",  # only the database knows it
                subject=walk["subject"], scratch=photographs, progress=lambda fraction: progress("board", fraction),
            )  # fmt: skip
    return _measured(progress, session, settings)


@contextmanager
def _numbered(files: Sequence[str], board: Mapping[str, Any], scratch: Path) -> Iterator[Path]:
    """A temporary folder with the photographs by number ("01.jpg"), or video.mp4, and board.toml."""
    shutil.rmtree(scratch, ignore_errors=True)  # left by a killed job
    with disk_errors(scratch):
        scratch.mkdir(mode=0o700)
        try:
            for number, file in enumerate(map(Path, files), start=1):
                ending = ".heic" if is_heic(file) else ".jpg"  # the reader recognises JPEG, PNG and TIFF by content
                _link(file, scratch / ("video.mp4" if is_video(file) else f"{number:02d}{ending}"))
            lines = [f"{name} = {json.dumps(value)}" for name, value in board.items()]
            (scratch / BOARD).write_text("\n".join(lines) + "\n", encoding="utf-8")
            yield scratch
        finally:
            shutil.rmtree(scratch, ignore_errors=True)


def _link(source: Path, goal: Path) -> None:
    try:
        os.link(source, goal)
    except OSError:  # a disk without hard links
        shutil.copy2(source, goal)


def _measured(progress: StageProgress, session: str, settings: str) -> dict[str, Any]:
    """Measure a visit's session with known cameras."""
    chosen = Settings.from_toml(settings)
    measured = measure_entry(progress, BatchEntry(address=session), settings)
    job = open_session(session, chosen)
    measurements = job.measure()
    rows = volume_rows(measurements, job.no_breast())
    return {
        "digest": _digest([key.digest for key in job.keys("measure")]),
        "made_at": job.made_at("measure"),
        "software": mammometry.__version__,
        "volumes": rows,
        **_numbers(measurements, job.plan, chosen, job.inputs.boundaries),
        "megapixels": measured["megapixels"],
    }


def measure_scan(progress: StageProgress, folder: str, settings: str) -> dict[str, Any]:
    """Measure a scan of another device.

    Args:
        progress: called with stage and fraction.
        folder: the visit's folder, made by `mammometry.io.meshes.scans`.
        settings: TOML.

    Returns:
        As `measure`. ``megapixels`` is 0.

    Raises:
        MammometryError: the job cannot be done.
    """
    progress("prepare", 0.0)
    job = open_session(folder, Settings.from_toml(settings), watch=lambda key: watched(key, progress))
    results = job.run()
    return {
        "digest": _digest([key.digest for key in job.keys("measure")]),
        "made_at": results.made_at,
        "software": mammometry.__version__,
        "volumes": volume_rows(results.measurements, results.no_breast),
        **_numbers(results.measurements, job.plan, Settings.from_toml(settings), job.inputs.boundaries),
        "megapixels": 0.0,
    }


def _numbers(
    measured: Mapping[str, VolumeMeasurement], plan: Plan, settings: Settings, drawn: Iterable[str]
) -> dict[str, Any]:
    """Digests of the boundaries, basis of the measurement, and every number with its name in exports."""
    curves = plan.value(boundaries) or ()
    otherwise = "landmarks" if settings.measure.boundary == "landmarks" else "automatic"
    return {
        "how": {
            "settings": measuring_settings(settings),
            "walls": {side: breast.wall_kind for side, breast in measured.items()},
            "boundaries": {side: "drawn" if side in set(drawn) else otherwise for side in measured},
        },
        "curves": {curve.name: curve_digest(curve.points_world) for curve in curves},
        "quantities": [_finite(asdict(quantity)) for quantity in quantities(tuple(measured.values()), plan)],
    }


def measuring_settings(settings: Settings) -> dict[str, Any]:
    """Settings of a measurement that differ from the defaults, by name."""
    ours, usual = (_flat(tomllib.loads(some.to_toml())) for some in (settings, Settings()))
    changed = {name: value for name, value in ours.items() if value != usual.get(name)}
    return _finite({name: value for name, value in changed.items() if name.split(".")[0] not in _CHANGE_NO_NUMBER})


def _flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in table.items():
        flat |= _flat(value, f"{before}{name}.") if isinstance(value, Mapping) else {f"{before}{name}": value}
    return flat


def volume_rows(measured: Mapping[str, VolumeMeasurement], no_breast: Mapping[str, str]) -> list[dict[str, Any]]:
    """Volumes of a measured session or scan.

    One row per side and definition, and one row for each side without a volume.
    """
    rows = []
    for side, measurement in measured.items():
        if not measurement.definitions:
            rows.append(_row(side, _WHOLE, measurement.volume_cc, measurement.interval_cc))
        for definition in measurement.definitions:
            rows.append(_row(side, definition.meaning, definition.volume_cc, definition.interval_cc))
    for side, why in no_breast.items():
        rows.append({**_row(side, _REFUSED, None, None), "refused": why})
    if {"left", "right"} <= set(measured):
        gap = difference(measured["left"], measured["right"], "sides")
        rows.append(_row("difference", "named wall", gap.difference_cc, gap.difference_interval_cc))
    return rows


def _row(
    side: str, definition: str, volume_cc: float | None, interval_cc: tuple[float, float] | None
) -> dict[str, Any]:
    low, high = interval_cc or (None, None)
    return {
        "side": side, "definition": definition, "volume_cc": volume_cc, "low_cc": low, "high_cc": high, "refused": "",
    }  # fmt: skip


def calibrate(progress: StageProgress, session: str, settings: str) -> dict[str, Any]:
    """Calibrate a rig and assess the calibration.

    Returns:
        ``digest`` of the cameras, and ``figures``: verdict, reasons, residuals, facts about each camera.

    Raises:
        MammometryError: the job cannot be done.
    """
    job = open_session(session, Settings.from_toml(settings))
    progress("calibrate", 0.0)
    cameras = job.calibrate()
    progress("calibrate", 0.9)
    result = job.calibration()
    figures: dict[str, Any] = {"verdict": cameras.verdict, "reasons": list(cameras.reasons), "rms_px": cameras.rms_px}
    if result is not None:
        quality = assess(result, job.settings.calibration.quality)
        figures |= {
            "doubts": [
                {
                    "sentence": words_of(doubt),
                    "photographs": [name.removeprefix("calibration/") for name in doubt.photographs],
                }
                for doubt in quality.doubts
            ],
            "rms_mm": quality.rms_mm,
            "rms_px_of": dict(quality.rms_px_per_camera),
            "coverage_of": dict(quality.coverage),
            "volume_coverage": quality.volume_coverage,
            "expected_mm_of": dict(quality.expected_mm),
            "scale_ppm_of": {pair.pair: pair.scale_ppm for pair in quality.pairs},
            "poses": len(quality.rms_px_per_pose),
            "worst_pair_mm": max(quality.expected_mm.values(), default=None),
        }
    figures["cameras"] = {name: about.as_table() for name, about in known_cameras(Path(session)).items()}
    return {"digest": job.plan[cameras_product].key.digest, "figures": _finite(figures)}


def known_cameras(session: Path) -> dict[str, KnownCamera]:
    """Cameras as known from a calibration's photographs."""
    files = {
        (path.parent.name, path.stem): path
        for path in sorted((session / "calibration").glob("*/*"))
        if path.suffix.lower() in EXTENSIONS
    }
    exposures = {shot: read_exposure(path) for shot, path in files.items()}
    ahead = clocks({shot: about.taken_s for shot, about in exposures.items() if about.taken_s is not None})
    known = {}
    for camera in dict.fromkeys(name for _, name in files):
        shots = [shot for shot in files if shot[1] == camera]
        header = read_header(files[shots[0]], camera)
        serials = {exposures[shot].serial for shot in shots}
        known[camera] = KnownCamera(
            stored_wh=header.stored_wh,
            orientation=header.orientation,
            serial=serials.pop() if len(serials) == 1 else "",
            clock_s=ahead.get(camera),
        )
    return known


def check(progress: StageProgress, calibration: str, folder: str, settings: str) -> dict[str, Any]:
    """Check with later photographs whether a rig has moved.

    An exposure that was already checked against this calibration is not added to the rig's history again.

    Returns:
        ``digest`` and ``figures``: the entry of the history.

    Raises:
        MammometryError: the job cannot be done.
    """
    job = open_session(calibration, Settings.from_toml(settings))
    progress("check", 0.0)
    now = job.plan[cameras_product].key.digest[:12]
    entries = drift.read_history(Path(calibration)).entries
    same = [entry for entry in entries if entry.image_set == folder and entry.calibration == now]
    pixels = _pixels(job.session, Path(folder)) if same else {}  # two of them may have been exchanged since
    entry = next((entry for entry in same if entry.photographs in ({}, pixels)), None)
    unseen: list[str] = []
    exchanged: list[str] = []
    if entry is None:
        result = job.check(folder, progress=lambda fraction: progress("check", fraction))
        unseen, exchanged = list(result.unseen), list(result.exchanged)
        history = drift.read_history(Path(calibration)).entries
        entry = next(entry for entry in reversed(history) if entry.image_set == folder)
    else:
        unseen = sorted(set(job.session.cameras) - set(entry.cameras))
    figures = check_table(
        entry,
        image_set=Path(folder).name,
        unseen=unseen,
        exchanged=exchanged,
        limit_mm=job.settings.calibration.check.refuse_mm,
    )
    return {"digest": _digest(figures), "figures": _finite(figures)}


def _pixels(session: Session, folder: Path) -> dict[str, str]:
    """Exposure and camera → digest of the photograph's pixels."""
    photographs, _ = session.image_set(folder)
    return {"/".join(shot): pixels_digest(photograph) for shot, photograph in photographs.items()}


def compare(
    progress: StageProgress, before: str, after: str, folder: str, digests: str, settings: str
) -> dict[str, Any]:
    """Compare two measured visits of one patient.

    Args:
        progress: called with stage and fraction.
        before: folder of the earlier visit.
        after: folder of the later visit.
        folder: for the comparison's page and pictures.
        digests: of both measurements, separated by a colon.
        settings: TOML.

    Returns:
        ``digest``, ``of`` and ``table``, the content of compare.json.

    Raises:
        MammometryError: the job cannot be done.
    """
    from mammometry.api.dates import compare_visits

    chosen = Settings.from_toml(settings)
    progress("compare", 0.0)
    for which, session, digest in zip(("earlier", "later"), (before, after), digests.split(":"), strict=True):
        if _digest([key.digest for key in open_session(session, chosen).keys("measure")]) != digest:
            raise SessionError(
                f"The {which} visit",
                found="results of a different software version, settings or drawings",
                expected="results of the current drawings and settings",
                remedy="Measure that visit again. Both are then compared automatically",
            )
    compared = compare_visits(
        Path(before), Path(after), chosen, out=Path(folder), progress=lambda share: progress("compare", share)
    )
    return {"digest": _digest(compared.table), "of": digests, "table": _finite(compared.table)}


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _finite(value: Any) -> Any:
    """Values for JSON, without infinity and NaN, which the database cannot store."""
    if isinstance(value, Mapping):
        return {str(name): _finite(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not (value == value and abs(value) != float("inf")):
        return None
    return value
