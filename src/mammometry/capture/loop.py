"""Capture at the press of one button, into a session that can be measured."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from mammometry.api.job import open_session
from mammometry.base.errors import CalibrationError, CaptureError, MammometryError, SessionError
from mammometry.base.machine.cores import available_cores
from mammometry.base.shell import command_line
from mammometry.calibration.detection.detect import SEARCH_WIDTH_PX, Detection, detect_in
from mammometry.calibration.judge.camera_names import check_board_names
from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.kinds.points import PointsTarget
from mammometry.calibration.targets.table import target_from_table
from mammometry.capture.camera import BACKENDS, Backend, Holds
from mammometry.capture.guide import GuideProgress, Suggestion, opening, progress, suggest
from mammometry.capture.sessions import (
    RigFile,
    definition_of,
    make_session,
    manifest_text,
    read_rig_file,
    share_calibration,
)
from mammometry.capture.shots import Firing, PendingShot, accept, add_pose, last_record, require_replaceable, take
from mammometry.capture.skew import Skew, read_moment, read_skew, skew_of, write_skew
from mammometry.capture.verdict import CaptureVerdict, Expected, judge
from mammometry.geometry.camera import Rig
from mammometry.io.manifest import MANIFEST, read_manifest
from mammometry.io.photographs.images import read_photograph
from mammometry.job.stages import calibrate

if TYPE_CHECKING:
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.calibration.targets.target import Target
    from mammometry.settings import Settings

_SEARCH_PX = 480  # width at which the board is searched to identify cameras, for which low accuracy is enough


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureResult:
    """Result of one capture."""

    shot: Path
    """Folder of its pictures, from all cameras that delivered one."""
    verdict: CaptureVerdict
    accepted: bool
    """Whether it became the session's capture."""
    written_s: float
    """Time from the pulse until the last picture was on the disk."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseResult:
    """Result of one pose of the calibration board."""

    pose: str
    """Its folder in ``calibration``. Empty if none was taken now."""
    count: int
    """Number of poses so far."""
    progress: GuideProgress | None
    """None while there are too few poses."""
    suggestion: Suggestion | None
    sentence: str
    """Where to hold the board next."""
    why: str = ""
    """Reason why there is no calibration yet."""


class OpenRig:
    """A rig's open cameras, with the data for checking their pictures.

    The calibration is read once, when the rig is opened, so that a verdict takes two seconds instead of twenty.
    """

    def __init__(
        self,
        rig_file: Path,
        *,
        backend: str | None = None,
        calibration: Path | None = None,
        own_calibration: bool = True,
        needs_calibration: bool = True,
        settings: Settings | None = None,
    ) -> None:
        """Open the cameras.

        Args:
            rig_file: rig.toml.
            backend: replaces the one in the file.
            calibration: session of the rig's calibration.
            own_calibration: without `calibration`, use the one named in the file, if any.
            needs_calibration: whether it must exist. False while the rig is being calibrated.
            settings: settings of the calibration; None: the defaults.

        Raises:
            SessionError: the rig's file is invalid, or its calibration is missing.
            SettingsError: the back-end is unknown or not installed.
            CaptureError: cameras do not answer, or another rig is using them.
            CalibrationError: the calibration that the file names failed.
        """
        self.file: RigFile = read_rig_file(rig_file)
        entry = self.file.capture
        opener = BACKENDS.find(backend or entry.backend, f"{rig_file}: capture.backend")
        self.calibration = calibration
        self.rig: Rig | None = None
        self.skew: Skew | None = None
        if calibration is None and own_calibration and entry.calibration is not None:
            self.calibration = rig_file.parent / entry.calibration
        if self.calibration is not None:
            self.rig = _rig_of(self.calibration, rig_file, settings) if needs_calibration else _known(self.calibration)
            self.skew = read_skew(self.calibration)
        self._holds = Holds(self.file.rig.name, backend or entry.backend, entry.cameras)
        try:
            self.backend: Backend = opener(self.file.devices)
        except BaseException:
            self._holds.release()
            raise
        try:
            self.backend.settings(self.file.settings)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> OpenRig:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Release the cameras."""
        self.backend.close()
        self._holds.release()

    @property
    def cameras(self) -> tuple[str, ...]:
        """All cameras of the rig."""
        return self.file.camera_names

    def faults(self) -> dict[str, str]:
        """Camera → its fault before a capture."""
        states = {name: self.backend.health(name) for name in self.cameras}
        return {name: state.fault for name, state in states.items() if state.fault}

    def fire_into(self, session: Path, *, subject_id: str | None = None) -> CaptureResult:
        """Capture pictures, write and check them. If they can be measured, they become the session's capture.

        Args:
            session: created if it does not exist.
            subject_id: pseudonym of the patient.

        Raises:
            SessionError: the session has photographs from another source.
            StorageError: no picture could be written.
            CaptureError: no camera delivered a picture.
        """
        prepare(session, self.file, self.calibration, subject_id=subject_id)
        require_replaceable(session)
        entry, before = self.file.capture, last_record(session)
        shot = PendingShot(session, suffix=entry.format)
        try:
            taken = take(
                self.backend, self.cameras, shot, timeout_s=entry.timeout_s, features=self.rig is not None
            )  # fmt: skip
            if not taken.frames:
                raise next(iter(taken.faults.values()), CaptureError(
                    "the rig", found="no picture", expected="one of every camera", remedy="Check the cables"
                ))  # fmt: skip
        except BaseException:
            shot.drop()
            raise
        verdict = judge(taken, self._expected(before, session))
        folder = shot.finish(record_of(taken, verdict, entry.backend))
        if verdict.may_be_measured:
            accept(session, folder)
            if self.skew is not None:
                write_skew(session, self.skew)
        written_s = max(frame.seconds for frame in taken.frames.values())
        return CaptureResult(shot=folder, verdict=verdict, accepted=verdict.may_be_measured, written_s=written_s)

    def fire_pose(self, session: Path) -> PoseResult:
        """Photograph the calibration board, calibrate with all poses so far, and suggest its next position.

        Args:
            session: session of the calibration, created if it does not exist.

        Raises:
            CaptureError: a camera delivered no picture, no camera saw the board, or two cables are swapped. The
            pictures are then discarded.
            SessionError: the rig's file has no target.
            StorageError: the disk is full or refuses.
        """
        if self.file.target is None:
            remedy = "Describe the calibration board: see docs/how-to/capture.md"
            raise SessionError(
                "the rig's file", found="no [target]", expected="the board for the calibration", remedy=remedy
            )
        prepare(session, self.file, None)
        shot = PendingShot(session, suffix=self.file.capture.format)
        try:
            taken = take(
                self.backend, self.cameras, shot, timeout_s=self.file.capture.timeout_s, features=False
            )  # fmt: skip
            if taken.faults:
                raise next(iter(taken.faults.values()))
            self._require_named(session, self._seen_on(taken, target_from_table(self.file.target)))
        except BaseException:
            shot.drop()
            raise
        return self.guidance(session, pose=add_pose(session, shot.finish({"format": 1, "pose": True})))

    def _seen_on(self, taken: Firing, target: Target) -> dict[str, Detection]:
        """Camera → the board in its picture. Refuses the pictures if none shows it.

        The dots of a `PointsTarget` look alike, and other programs may measure them, so that target need not be found.
        """

        def seen(width_px: int) -> dict[str, Detection]:
            def detected(camera: str) -> Detection | None:
                photograph = read_photograph(taken.frames[camera].path, camera)
                return detect_in(photograph, target, camera=camera, pose="", search_width_px=width_px)

            with ThreadPoolExecutor(available_cores()) as pool:
                points = dict(zip(taken.frames, pool.map(detected, taken.frames), strict=True))
            return {name: detection for name, detection in points.items() if detection is not None}

        found = seen(_SEARCH_PX) or seen(SEARCH_WIDTH_PX)
        if not found and not isinstance(target, PointsTarget):
            raise CaptureError(
                "the pose", found="no picture with the board: no camera saw it", expected="the board of [target]",
                remedy="Hold it in the cameras' view, in the light, and fire again; these pictures are not kept",
            )  # fmt: skip
        return found

    def _require_named(self, session: Path, found: Mapping[str, Detection]) -> None:
        """Refuse a pose if its pictures show that two cables are swapped."""
        known = self._calibrated_so_far(session) or self.rig
        swapped = None if known is None else check_board_names(known, found)
        if swapped is not None:
            raise CaptureError(
                " and ".join(swapped), found="exchanged: each shows the other's view of the board",
                expected="each camera's own picture", remedy="Exchange their cables, and take the pose again",
            )  # fmt: skip

    def _calibrated_so_far(self, session: Path) -> Rig | None:
        try:
            calibration = _calibration_of(session)
        except (CalibrationError, SessionError):  # there are too few poses yet
            return None
        return None if calibration is None else calibration.rig

    def guidance(self, session: Path, *, pose: str = "") -> PoseResult:
        """Quality of the calibration, and the next position of the board.

        Args:
            session: session of the calibration, which need not exist.
            pose: the latest one, if any.
        """
        pairs = tuple(pair.name for pair in self.file.rig.pairs)
        if not (session / "calibration").is_dir():
            return PoseResult(pose=pose, count=0, progress=None, suggestion=None, sentence=opening(pairs, 0))
        count = sum(1 for path in (session / "calibration").iterdir() if path.name.isdecimal())
        try:
            calibration = _calibration_of(session)
        except (CalibrationError, SessionError) as error:  # there are too few poses yet
            return PoseResult(
                pose=pose, count=count, progress=None, suggestion=None, sentence=opening(pairs, count), why=str(error)
            )
        assert calibration is not None  # the rig's file has a target, and no given cameras
        next_one = suggest(calibration)
        so_far = progress(calibration)
        return PoseResult(
            pose=pose,
            count=count,
            progress=so_far,
            suggestion=next_one,
            sentence=opening(pairs, count) if next_one is None else next_one.sentence,
        )

    def measure_skew(self, session: Path, *, firings: int = 5) -> Skew:
        """Photograph the counting lamps, and write the cameras' time differences into a session.

        Pictures are kept in ``SESSION/skew/shots``. ``skew.json`` is replaced.

        Args:
            session: session of the rig's calibration.
            firings: number of exposures, of which the median is used.

        Raises:
            CaptureError: a camera delivered no picture, or the lamps are not in it.
            SessionError: the rig's file has no board or no exposure time.
            StorageError: the disk is full or refuses.
        """
        board = None if self.file.target is None else target_from_table(self.file.target)
        exposure_ms = self.file.capture.exposure_ms
        if not isinstance(board, Board) or exposure_ms is None:
            raise SessionError(
                "the rig's file",
                found="no flat [target]" if exposure_ms is not None else "no exposure_ms in [capture]",
                expected="the board with the lamps, and the exposure time",
                remedy="Add it",
            )
        seen = []
        for _ in range(firings):
            shot = PendingShot(session / "skew", suffix="png" if self.file.capture.format == "png" else "jpg")
            try:
                self.backend.arm()
                self.backend.fire()
                frames = {name: self.backend.fetch(name, self.file.capture.timeout_s) for name in self.cameras}
                paths = {name: shot.keep(frame) for name, frame in frames.items()}
                seen.append({
                    name: read_moment(read_photograph(path, name), board, exposure_ms, camera=name)
                    for name, path in paths.items()
                })  # fmt: skip
            except BaseException:
                shot.drop()
                raise
            moments = {
                name: {"begin_ms": moment.begin_ms, "std_ms": moment.std_ms} for name, moment in seen[-1].items()
            }
            shot.finish({"format": 1, "moments": moments})
        self.skew = skew_of(seen, exposure_ms)
        write_skew(session, self.skew)
        return self.skew

    def _expected(self, before: dict[str, object] | None, session: Path) -> Expected:
        return Expected(
            cameras=self.cameras,
            subject_kind=read_manifest(session / MANIFEST).subject.kind,
            rig=self.rig,
            serials=self.file.capture.cameras,
            before=before,
            skew=self.skew,
            skew_limit_ms=self.file.capture.skew_limit_ms,
        )


def prepare(session: Path, file: RigFile, calibration: Path | None, *, subject_id: str | None = None) -> None:
    """Create the session's folder with the rig's calibration. An existing manifest is not changed.

    Raises:
        StorageError: the disk is full or refuses.
    """
    if not (session / "session.toml").exists():
        today = datetime.datetime.now().astimezone().date()
        text = manifest_text(definition_of(file), file.subject.kind, subject_id or file.subject.id, today)
        make_session(session, text)
    if calibration is not None:
        share_calibration(calibration, session)


def record_of(taken: Firing, verdict: CaptureVerdict, backend: str) -> dict[str, object]:
    """Content of shot.json for a capture."""
    when = datetime.datetime.fromtimestamp(taken.fired_s, datetime.UTC).isoformat(timespec="milliseconds")
    return {
        "format": 1,
        "fired": when,
        "backend": backend,
        "cameras": {
            name: {
                "file": frame.path.name,
                "sha256": frame.sha256,
                "taken_s": frame.taken_s,
                "clock": frame.clock,
                "number": frame.number,
                "serial": frame.serial,
                "seconds": round(frame.seconds, 3),
            }
            for name, frame in taken.frames.items()
        },
        "faults": {name: str(error) for name, error in taken.faults.items()},
        "verdict": verdict.as_table(),
    }


def _rig_of(calibration: Path, rig_file: Path, settings: Settings | None) -> Rig:
    """Cameras of the calibration that the rig's file names.

    Raises:
        SessionError: it is missing. The message states how to make it.
        CalibrationError: it failed.
    """
    if not calibration.exists():
        made = command_line("mammometry", "capture", calibration, "--rig", rig_file, "--pose")
        raise SessionError(
            f"{rig_file}: capture.calibration",
            found=f"no folder {calibration}",
            expected="the session of the rig's calibration",
            remedy=f"Calibrate the rig first, pose by pose: {made}",
        )
    return open_session(calibration, settings).calibrate().rig


def _known(calibration: Path) -> Rig | None:
    """Cameras of an earlier calibration. None if there is none."""
    try:
        made = _calibration_of(calibration)
    except MammometryError:
        return None
    return None if made is None else made.rig


def _calibration_of(session: Path) -> Calibration | None:
    """Calibration with all poses so far. Previews are left out, because they would double the time."""
    job = open_session(session)
    job.ensure("calibrate", drawn=False)
    return job.plan.value(calibrate.calibration)
