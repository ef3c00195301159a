"""Verdict on a capture, available before the patient dresses.

It checks that every camera delivered its own picture of this capture, that all were exposed together, sharp and well
exposed, and that the subject did not move and is completely in view. Each sentence states what to do.
"""

import statistics
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mammometry.calibration.judge.camera_names import PhotographCheck, check_names, wrong_photographs
from mammometry.capture import camera_checks, checks
from mammometry.capture.camera_checks import KnownCamera
from mammometry.capture.checks import Finding, refuses
from mammometry.capture.shots import Firing
from mammometry.capture.skew import Skew
from mammometry.geometry.camera import Rig

_OLD_S = 2.0  # largest time before the pulse: shared clocks differ by far less


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureVerdict:
    """All findings, worst first."""

    findings: tuple[tuple[str, Finding], ...]
    """Camera, or empty if it is about all together, and the finding."""
    seconds: float
    """Time from the pulse to the verdict."""

    @property
    def may_be_measured(self) -> bool:
        """Whether there is no refusal."""
        return not refuses(finding for _, finding in self.findings)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences for the technician, worst first. Each check that passed is mentioned once."""
        bad = [(who, finding) for who, finding in self.findings if finding.level in ("refuse", "warn")]
        lines = [f"{who}: {finding.sentence}" if who else finding.sentence for who, finding in bad]
        for check in dict.fromkeys(finding.check for _, finding in self.findings):
            alike = [finding for _, finding in self.findings if finding.check == check]
            if all(finding.level == "ok" for finding in alike):
                lines.append(_WELL.get(check, alike[0].sentence))
            lines += [finding.sentence for finding in alike if finding.level == "unknown"][:1]
        return tuple(lines)

    def as_table(self) -> dict[str, Any]:
        """The verdict as JSON."""
        return {
            "may_be_measured": self.may_be_measured,
            "seconds": round(self.seconds, 3),
            "checks": [{"camera": who, **finding.as_table()} for who, finding in self.findings],
        }


_WELL = {
    "delivered": "All cameras delivered.",
    "size": "All pictures have the size of the calibration.",
    "sharpness": "All pictures are sharp.",
    "exposure": "All pictures are well exposed.",
    "whole": "The subject is in all pictures.",
    "serial": "All cameras are those of the rig's file.",
    "fresh": "All pictures are of this firing.",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expected:
    """Facts about a rig with which a capture is compared."""

    cameras: tuple[str, ...]
    subject_kind: str
    rig: Rig | None = None
    """Cameras from the calibration. None if the rig is not calibrated yet."""
    serials: Mapping[str, str] | None = None
    """Camera → serial number in the rig's file."""
    before: Mapping[str, Any] | None = None
    """Record of the last capture."""
    skew: Skew | None = None
    """Measured time differences between this rig's cameras."""
    skew_limit_ms: float = 1.0


def judge(taken: Firing, expected: Expected) -> CaptureVerdict:
    """Decide whether a capture may be measured.

    Args:
        taken: the capture.
        expected: what is known about the rig.
    """
    begun = time.monotonic()
    findings = [
        *_delivered(taken, expected),
        *_sizes(taken, expected),
        *_serials(taken, expected),
        *_fresh(taken, expected),
        ("", _together(taken, expected)),
        ("", _skew(expected)),
        *_names_and_stillness(taken, expected),
    ]
    for name, frame in taken.frames.items():
        findings += [(name, finding) for finding in checks.judge(frame.seen, expected.subject_kind)]
    order = {"refuse": 0, "warn": 1, "unknown": 2, "ok": 3}
    findings.sort(key=lambda named: order[named[1].level])
    return CaptureVerdict(findings=tuple(findings), seconds=taken.seconds + time.monotonic() - begun)


def _delivered(taken: Firing, expected: Expected) -> Iterator[tuple[str, Finding]]:
    for name in expected.cameras:
        fault = taken.faults.get(name)
        if fault is not None:
            yield name, _refuse("delivered", f"No picture: {fault.found}. {fault.remedy.rstrip('.')}.")
        elif name in taken.frames:
            yield name, Finding("delivered", "ok", "Delivered.")
    yield from (
        ("", finding) for finding in camera_checks.twice({name: frame.sha256 for name, frame in taken.frames.items()})
    )


def _sizes(taken: Firing, expected: Expected) -> Iterator[tuple[str, Finding]]:
    known = {} if expected.rig is None else {
        name: KnownCamera(stored_wh=camera.size_wh) for name, camera in expected.rig.cameras.items()
    }  # fmt: skip
    for name, frame in taken.frames.items():
        yield name, camera_checks.right_size(name, frame.size_wh, 1, known)


def _serials(taken: Firing, expected: Expected) -> Iterator[tuple[str, Finding]]:
    wanted = expected.serials or {}
    for name, frame in taken.frames.items():
        if not frame.serial or name not in wanted:
            continue
        if frame.serial == wanted[name]:
            yield name, Finding("serial", "ok", "Its serial number is right.")
            continue
        other = next((camera for camera, serial in wanted.items() if serial == frame.serial), None)
        by = other or f"a camera with serial number {frame.serial}, which the rig's file does not have"
        yield (
            name,
            _refuse("serial", f"This picture was taken by {by}. Exchange the cables, or correct the rig's file."),
        )


def _fresh(taken: Firing, expected: Expected) -> Iterator[tuple[str, Finding]]:
    """Check whether each picture is from this capture."""
    before = (expected.before or {}).get("cameras", {})
    counts = {name: frame.number for name, frame in taken.frames.items() if frame.number is not None}
    usual = statistics.mode(counts.values()) if counts else None
    for name, frame in taken.frames.items():
        earlier = before.get(name, {})
        if earlier.get("sha256") == frame.sha256:
            yield (
                name,
                _refuse("fresh", "This is the picture of the previous firing. Restart the camera, and fire again."),
            )
        elif frame.taken_s is not None and frame.clock in ("host", "ptp") and frame.taken_s < taken.fired_s - _OLD_S:
            ago = taken.fired_s - frame.taken_s
            yield name, _refuse("fresh", f"An old picture, taken {ago:.0f} s before the flash. Fire again.")
        elif usual is not None and len(set(counts.values())) == 2 and frame.number == usual - 1:
            yield name, _refuse("fresh", "The camera is one picture behind the others. Restart it, and fire again.")
        else:
            yield name, Finding("fresh", "ok", "Of this firing.")


def _together(taken: Firing, expected: Expected) -> Finding:
    times = {name: frame.taken_s for name, frame in taken.frames.items() if frame.taken_s is not None}
    clocks = {frame.clock for frame in taken.frames.values()}
    if len(times) < 2 or clocks - {"ptp", "exif"}:
        return Finding(
            "times", "unknown", "The cameras do not report their exposure time. Measure their skew."
        )  # fmt: skip
    if clocks != {"ptp"}:
        return camera_checks.together(times, {})
    middle = statistics.median(times.values())
    worst = max(times, key=lambda name: abs(times[name] - middle))
    spread_ms = 1e3 * (max(times.values()) - min(times.values()))
    if spread_ms > expected.skew_limit_ms:
        apart_ms = 1e3 * (times[worst] - middle)
        how = "after" if apart_ms > 0 else "before"
        return _refuse(
            "times",
            f"{worst} exposed {abs(apart_ms):.1f} ms {how} the others; {expected.skew_limit_ms:g} ms are allowed. "
            "Check its trigger wire, and fire again.",
        )
    return Finding("times", "ok", f"All exposed within {spread_ms:.2f} ms, by their clock.")


def _skew(expected: Expected) -> Finding:
    skew = expected.skew
    if skew is None:
        level = "warn" if expected.subject_kind == "torso" else "unknown"
        return Finding(
            "skew", level,  # type: ignore[arg-type]
            "The cameras' skew was never measured. Photograph the counting lamps: mammometry skew.",
        )  # fmt: skip
    missing = [name for name in expected.cameras if name not in skew.offset_ms]
    if missing:
        return Finding("skew", "warn", f"The skew of {', '.join(missing)} was not measured.")
    sentence = f"Measured skew of the cameras: {skew.spread_ms:.2f} ± {skew.std_ms:.2f} ms"
    if skew.spread_ms > expected.skew_limit_ms:
        level = "refuse" if expected.subject_kind == "torso" else "warn"
        return Finding(
            "skew", level,  # type: ignore[arg-type]
            f"{sentence}, largest at {skew.worst}. The limit for a patient is {expected.skew_limit_ms:g} ms. "
            "Check the trigger wires.",
        )  # fmt: skip
    return Finding("skew", "ok", f"{sentence}.")


def _names_and_stillness(taken: Firing, expected: Expected) -> Iterator[tuple[str, Finding]]:
    if expected.rig is None:
        yield "", Finding("names", "unknown", "Camera names are not checked: the rig is not calibrated.")
        return
    sizes_fit = {
        name: frame.features
        for name, frame in taken.frames.items()
        if frame.features is not None and name in expected.rig.cameras
        and frame.size_wh == expected.rig.cameras[name].size_wh
    }  # fmt: skip
    names = check_names(expected.rig, sizes_fit)
    yield from (("", finding) for finding in _named(names, expected.rig))
    if names.right:
        yield "", _stillness(names)


def _named(names: PhotographCheck, rig: Rig) -> Iterator[Finding]:
    for wrong in wrong_photographs(names, rig.pair_names):
        remedy = "Exchange their cables" if set(wrong.cameras) <= set(names.exchanged) else "Check cables and cameras"
        yield _refuse("names", f"{wrong.listed}: {wrong.found}. {remedy}.")
    if names.unknown:
        yield Finding(
            "names", "unknown",
            f"Too little texture to check the camera names of pair {', '.join(names.unknown)}.",
        )  # fmt: skip
    if names.pairs and names.right and not names.unknown:
        yield Finding("names", "ok", "All camera names agree with the calibration.")


def _stillness(names: PhotographCheck) -> Finding:
    known = {name: pair for name, pair in names.pairs.items() if pair.is_sufficient and np.isfinite(pair.offset_mm)}
    if not known:
        return Finding("moved", "unknown", "Too little texture to check whether the patient moved.")
    worst = max(known, key=lambda name: abs(known[name].offset_mm))
    if known[worst].moved:
        return _refuse(
            "moved",
            f"Pair {worst} is {abs(known[worst].offset_mm):.1f} mm off. The patient moved between its two "
            "exposures, or a camera was touched. Fire again; if this repeats, check the rig.",
        )
    return Finding(
        "moved", "ok",
        "The patient did not move: views agree to "
        f"{max(abs(agreement.offset_mm) for agreement in known.values()):.2f} mm.",
    )  # fmt: skip


def _refuse(check: str, sentence: str) -> Finding:
    return Finding(check, "refuse", sentence)
