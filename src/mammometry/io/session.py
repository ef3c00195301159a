"""The session folder: photographs and manifest as input, with the results next to them.

::

    SESSION/session.toml
        SESSION/calibration/<pose>/<camera>.<ext>    all cameras that saw the target in that pose
        SESSION/calibration/<pose>/<camera>.csv      optional: the target's points in it (id,u,v), measured elsewhere
        SESSION/capture/<camera>.<ext> SESSION/intrinsics/<camera>/*.<ext>          optional: unsynchronised photographs
        of the [intrinsics] target
    SESSION/cameras.json                         optional: ready-made cameras (`mammometry import-cameras`)
    SESSION/prior.json                           optional: the rig's last cameras.json: prior for the lenses
    SESSION/masks/<camera>.png                   optional: white where the subject is
    SESSION/boundaries.json                      optional: closed curves around the breasts, world frame, mm
    SESSION/landmarks.json                       optional: anatomical landmarks, world frame, mm
    SESSION/wall.ply                             optional: the wall behind the breast, measured separately, world, mm
    SESSION/results/<stage>/...                  written by mammometry only
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mammometry.base.errors import ImageError, SessionError
from mammometry.base.identity import Identity
from mammometry.base.listing import visible
from mammometry.base.parse import LimitSettings
from mammometry.base.photograph import Photograph
from mammometry.geometry import Array, Camera
from mammometry.io.cameras.own import read_cameras, read_priors
from mammometry.io.csv_tables import read_table
from mammometry.io.drawn import boundaries_digest, landmarks_digest, read_boundaries, read_landmarks
from mammometry.io.looked_up import KeptMapping, LazyMapping, SharedMapping, digest_of, file_digest
from mammometry.io.manifest import MANIFEST, Manifest, read_manifest
from mammometry.io.meshes.own import read_wall
from mammometry.io.photographs.images import (
    EXTENSIONS,
    UNREAD_ENDINGS,
    ImageHeader,
    check_sizes,
    read_header,
    read_mask,
    read_photograph,
)
from mammometry.io.subject import check_session
from mammometry.job.inputs import MISSING, Inputs, Walk
from mammometry.job.products import Stage
from mammometry.walk.region import Region

if TYPE_CHECKING:
    from mammometry.base.photograph import MeasuredPoints
    from mammometry.calibration.adjust.projection import CameraPrior

_MIN_POSES = 3  # fewest poses of a board: fewer do not determine a camera's lens (Zhang 2000)
_BROUGHT = (
    MANIFEST,
    *("calibration", "capture", "intrinsics", "cameras.json", "prior.json"),
    *("masks", "boundaries.json", "landmarks.json", "wall.ply", "set-aside"),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Session:
    """A session folder with a valid manifest."""

    path: Path
    manifest: Manifest
    limits: LimitSettings = field(default_factory=LimitSettings)
    """Largest sizes of its photographs."""

    @classmethod
    def open(cls, path: Path | str) -> Session:
        """Open a session folder.

        Raises:
            SessionError: there is no folder or no manifest, the manifest is invalid, or drawings or results are of
            another subject than the manifest's.
        """
        folder = Path(path)
        manifest = read_manifest(folder / MANIFEST)
        check_session(folder, manifest.subject.id)
        return cls(path=folder, manifest=manifest)

    @property
    def identity(self) -> Identity:
        """Subject and name of the session."""
        return Identity.of(self.path, self.manifest.subject.id, self.manifest.date)

    @property
    def results(self) -> Path:
        """Folder of the results."""
        return self.path / "results"

    @property
    def brought(self) -> tuple[Path, ...]:
        """The user's files and folders, which no command may change."""
        return tuple(self.path / name for name in _BROUGHT)

    @property
    def pair_names(self) -> dict[str, tuple[str, str]]:
        """Pair → its left and right camera, in the manifest's order."""
        return {pair.name: (pair.left, pair.right) for pair in self.manifest.rig.pairs}

    @property
    def cameras(self) -> tuple[str, ...]:
        """All cameras of the pairs, without duplicates, in the manifest's order."""
        return tuple(dict.fromkeys(camera for pair in self.pair_names.values() for camera in pair))

    def measured_points(self) -> dict[tuple[str, str], MeasuredPoints]:
        """(pose, camera) → table of the target's points in that calibration photograph.

        Raises:
            SessionError: a table has other columns than ``id,u,v``.
        """
        return {shot: _read_points(path, self._name(path)) for shot, path in self._points_files().items()}

    def image_set_files(self, folder: Path) -> dict[tuple[str, str], Path]:
        """(exposure, camera) → file of a later photograph of the target, as for `image_set`."""
        exposures = [folder] if self._images(folder) else _folders(folder)
        return {
            (exposure.name, camera): path for exposure in exposures for camera, path in self._images(exposure).items()
        }

    def calibration_files(self) -> dict[tuple[str, str], Path]:
        """(pose, camera) → file of a calibration photograph."""
        return self._calibration_files()

    def image_set(
        self, folder: Path
    ) -> tuple[Mapping[tuple[str, str], Photograph], dict[tuple[str, str], MeasuredPoints]]:
        """(exposure, camera) → later photographs of the target, and point tables.

        Args:
            folder: ``<camera>.<ext>`` of one exposure, or one such folder per exposure.

        Raises:
            SessionError: there is no such folder, it is empty, or a photograph is from a camera that is in no pair.
        """
        files = self.image_set_files(folder)
        if not files:
            raise SessionError(
                str(folder),
                found="no photographs" if folder.is_dir() else "no such folder",
                expected="<camera>.jpg of each camera that sees the target",
                remedy="Photograph the target once with all cameras, and give that folder",
            )
        for (_, camera), path in files.items():
            if camera not in self.cameras:
                remedy = _perhaps(camera, list(self.cameras)) or "Rename or remove it"
                expected = f"one of {', '.join(self.cameras)}"
                raise SessionError(
                    str(path), found="a photograph of an unknown camera", expected=expected, remedy=remedy
                )
        tables = {shot: path.with_suffix(".csv") for shot, path in files.items() if path.with_suffix(".csv").is_file()}
        points = {shot: _read_points(path, str(path)) for shot, path in tables.items()}
        return LazyMapping(files, lambda shot, path: read_photograph(path, str(path), self.limits)), points

    def require(self, stage: Stage) -> None:
        """Require all files for a stage and for the earlier ones, calibration before capture.

        Raises:
            SessionError: there are too few calibration poses, or a camera has no photograph.
        """
        if self._ready_cameras() is None:
            self._require_calibration(self._calibration_files())
            self._require_each_own(self._calibration_files())
        if stage != "calibrate":
            self._require_each_own({("", camera): path for camera, path in self._capture_files().items()})

    def inputs(self) -> Inputs:
        """All inputs in the session folder, checked as far as their headers allow.

        Pixels are read on look-up. Missing files are reported only by `require`.

        Raises:
            SessionError: a photograph is duplicated, a camera is unknown, or the manifest or another file is malformed.
            ImageError: a photograph is unreadable, or its size differs from that of its camera's others.
        """
        from mammometry.calibration.targets.table import target_from_table

        cameras = self._ready_cameras()
        capture, calibration = self._all_capture_files(), self._calibration_files()
        intrinsics = self._intrinsics_files() if cameras is None else {}
        manifest = self.manifest
        if manifest.target is None and cameras is None:
            remedy = "Describe the calibration target, or import cameras with `mammometry import-cameras`"
            raise SessionError(
                MANIFEST, found="neither a [target] nor a cameras.json", expected="one of them", remedy=remedy
            )
        present = {camera: path for camera, path in capture.items() if path.exists()}
        self._check_headers(present, calibration if cameras is None else {}, intrinsics, cameras)
        masks = self._mask_files(capture)
        drawn = read_boundaries(self.path, manifest.subject.kind, manifest.subject.id)
        landmarks = read_landmarks(self.path, manifest.subject.kind, manifest.subject.id)
        wall = self.path / "wall.ply"
        known = {
            "rig": lambda: digest_of([manifest.rig.name, list(self.pair_names.items())]),
            "subject": lambda: digest_of(manifest.subject.kind),
            "target": lambda: digest_of(manifest.target),
            "intrinsics-target": lambda: digest_of(None if manifest.intrinsics is None else manifest.intrinsics.target),
            "cameras": lambda: file_digest(self.path / "cameras.json"),
            "prior": lambda: file_digest(self.path / "prior.json"),
            "boundaries": lambda: boundaries_digest(drawn),
            "landmarks": lambda: landmarks_digest(landmarks),
            "wall": lambda: file_digest(wall) if wall.is_file() else MISSING,
        }
        files = self.files()
        made: Mapping[str, Callable[[], str]] = {
            **{f"capture/{camera}": lambda: MISSING for camera in capture},
            **known,
            **{name: lambda path=path: file_digest(path) for name, path in files.items()},  # type: ignore[misc]
        }
        digests = KeptMapping(made, lambda name, digest: digest())

        def photograph(name: str, path: Path) -> Photograph:
            """Read the file, if it is still the one whose digest is in the product's key."""
            digest = digests.get(name)
            return read_photograph(path, self._name(path), self.limits, digest=None if digest == MISSING else digest)

        return Inputs(
            rig_name=manifest.rig.name,
            pair_names=self.pair_names,
            mounting=manifest.rig.turned,
            subject_kind=manifest.subject.kind,
            rim_radius_mm=manifest.subject.rim_radius_mm,
            photographs=SharedMapping(
                capture,
                lambda camera, path: photograph(f"capture/{camera}", path),
                bytes_of=lambda taken: taken.pixels.nbytes,
            ),
            target=None if manifest.target is None else target_from_table(manifest.target),
            calibration_photographs=LazyMapping(
                calibration, lambda shot, path: photograph(f"calibration/{shot[0]}/{shot[1]}", path)
            ),
            measured_points={} if cameras is not None else self.measured_points(),
            intrinsics_target=None if manifest.intrinsics is None else target_from_table(manifest.intrinsics.target),
            intrinsics_photographs={
                camera: LazyMapping(shots, lambda shot, path: photograph(f"intrinsics/{shot[1]}/{shot[0]}", path))
                for camera, shots in intrinsics.items()
            },
            cameras=cameras,
            priors={} if cameras is not None else self._priors(),
            masks=LazyMapping(
                masks,
                lambda camera, path: self._checked_mask(camera, path, capture[camera], digests[f"masks/{camera}"]),
            ),
            boundaries=drawn.curves,
            automatic=drawn.automatic,
            removed=drawn.removed,
            attributions=drawn.attributions,
            landmarks=landmarks,
            wall=read_wall(wall) if wall.is_file() else None,
            digests=digests,
            head_stated=manifest.walk is not None,
            walk=self._walk(),
        )

    def _walk(self) -> Walk | None:
        entry = self.manifest.walk
        if entry is None:
            return None
        low, high = np.array(entry.region_mm)
        region = Region(low_world=low, high_world=high)
        return Walk(
            region=region,
            scale_std=entry.scale_std,
            point_std_mm=entry.point_std_mm,
            card_scale=entry.card_scale,
            board_mm=np.array(entry.board_mm),
        )

    # --- files ---

    def files(self) -> dict[str, Path]:
        """All existing photographs, masks and tables, by their names in `Inputs.digests`."""
        capture = self._all_capture_files()
        files = {f"capture/{camera}": path for camera, path in capture.items() if path.exists()}
        files |= {f"calibration/{pose}/{camera}": path for (pose, camera), path in self._calibration_files().items()}
        if self._ready_cameras() is None:
            files |= {
                f"intrinsics/{camera}/{exposure}": path
                for camera, shots in self._intrinsics_files().items()
                for (exposure, _), path in shots.items()
            }
        files |= {f"points/{pose}/{camera}": path for (pose, camera), path in self._points_files().items()}
        return files | {f"masks/{camera}": path for camera, path in self._mask_files(capture).items()}

    def _name(self, path: Path) -> str:
        return path.relative_to(self.path).as_posix() if path.is_relative_to(self.path) else str(path)

    def _images(self, folder: Path) -> dict[str, Path]:
        """Stem → image file, sorted by name. Other files are ignored."""
        files: dict[str, Path] = {}
        for path in visible(folder):
            if path.suffix.lower() not in EXTENSIONS or not path.is_file():
                continue
            if path.stem in files:
                raise SessionError(
                    self._name(path),
                    found=f"a second photograph next to {files[path.stem].name}",
                    expected="one per camera",
                    remedy="Remove one of them",
                )
            files[path.stem] = path
        return files

    def _require_read(self, folder: Path, files: Mapping[str, Path]) -> None:
        """Refuse a camera's image in an unsupported format, if there is no other image of the camera."""
        for path in visible(folder):
            if path.suffix.lower() in UNREAD_ENDINGS and path.stem in self.cameras and path.stem not in files:
                raise SessionError(
                    self._name(path),
                    found=f"an image in a format that is not read ({path.suffix[1:].upper()})",
                    expected="JPEG, PNG or TIFF",
                    remedy="Export it as JPEG or TIFF, uncropped and uncorrected, and set the camera to JPEG",
                )

    def _require_each_own(self, files: Mapping[tuple[str, str], Path]) -> None:
        """Refuse the same file as the photograph of two cameras. (pose, camera) → file."""
        first: dict[str, tuple[str, str]] = {}
        for shot, path in files.items():
            other = first.setdefault(file_digest(path), shot)
            if other[1] != shot[1]:
                raise SessionError(
                    self._name(path),
                    found=f"the same file as {self._name(files[other])}",
                    expected=f"a photograph of camera {shot[1]}",
                    remedy="Copy each camera's own photograph again",
                )

    def _capture_files(self) -> dict[str, Path]:
        files = self._images(self.path / "capture")
        self._require_read(self.path / "capture", files)
        for camera in self.cameras:
            if camera not in files:
                raise SessionError(
                    f"capture/{camera}",
                    found="no photograph" + (f" (but {', '.join(files)})" if files else ", the folder is empty"),
                    expected="one of each camera in the pairs",
                    remedy=_perhaps(camera, [name for name in files if name not in self.cameras])
                    or "Add the photograph, or remove the pair from session.toml",
                )
        others = [name for name in files if name not in self.cameras]
        return {name: files[name] for name in (*self.cameras, *others)}

    def _all_capture_files(self) -> dict[str, Path]:
        """Capture files of all cameras of the pairs, whether they exist or not."""
        files = self._images(self.path / "capture")
        return {camera: files.get(camera, self.path / "capture" / camera) for camera in (*self.cameras, *files)}

    def _calibration_files(self) -> dict[tuple[str, str], Path]:
        folder = self.path / "calibration"
        return {(pose.name, camera): path for pose in _folders(folder) for camera, path in self._images(pose).items()}

    def _points_files(self) -> dict[tuple[str, str], Path]:
        tables = {shot: path.with_suffix(".csv") for shot, path in self._calibration_files().items()}
        return {shot: table for shot, table in tables.items() if table.is_file()}

    def _intrinsics_files(self) -> dict[str, dict[tuple[str, str], Path]]:
        if self.manifest.intrinsics is None:
            return {}
        files = {
            camera: {(shot, camera): path for shot, path in self._images(self.path / "intrinsics" / camera).items()}
            for camera in self.cameras
        }
        for camera, shots in files.items():
            if not shots:
                remedy = "Add them, or remove [intrinsics] from session.toml"
                expected = "photographs of the [intrinsics] target by each camera"
                raise SessionError(f"intrinsics/{camera}", found="no photograph", expected=expected, remedy=remedy)
        return files

    def _mask_files(self, capture: Mapping[str, Path]) -> dict[str, Path]:
        files = self._images(self.path / "masks")
        for camera, path in files.items():
            if camera not in capture:
                remedy = _perhaps(camera, list(capture)) or "Rename or remove it"
                expected = f"one of {', '.join(capture)}"
                raise SessionError(
                    self._name(path), found="a mask without a photograph", expected=expected, remedy=remedy
                )
        return files

    def _ready_cameras(self) -> dict[str, Camera] | None:
        path = self.path / "cameras.json"
        return read_cameras(path) if path.is_file() else None

    def _priors(self) -> dict[str, CameraPrior]:
        path = self.path / "prior.json"
        return read_priors(path) if path.is_file() else {}

    # --- checks ---

    def _require_calibration(self, files: Mapping[tuple[str, str], Path]) -> None:
        from mammometry.calibration.targets.table import target_from_table

        assert self.manifest.target is not None
        for pose in _folders(self.path / "calibration"):
            self._require_read(pose, self._images(pose))
        least = 1 if target_from_table(self.manifest.target).is_surveyed else _MIN_POSES
        poses = sorted({pose for pose, _ in files})
        if len(poses) < least:
            raise SessionError(
                "calibration",
                found=f"{len(poses)} poses" + (f" ({', '.join(poses)})" if poses else ""),
                expected=f"at least {least}, each a folder with photographs of the target",
                remedy="Photograph the target in more poses",
            )
        seen = {camera for _, camera in files}
        for camera in self.cameras:
            if camera not in seen:
                raise SessionError(
                    f"calibration/*/{camera}",
                    found=f"no photograph of camera {camera} in any pose",
                    expected="each camera in the pairs",
                    remedy=_perhaps(camera, sorted(seen - set(self.cameras)))
                    or "Add its calibration photographs, or remove the pair from session.toml",
                )

    def _check_headers(
        self,
        capture: Mapping[str, Path],
        calibration: Mapping[tuple[str, str], Path],
        intrinsics: Mapping[str, Mapping[tuple[str, str], Path]],
        cameras: Mapping[str, Camera] | None,
    ) -> None:
        known = set(cameras or {camera for _, camera in calibration})
        for camera, path in capture.items():
            if known and camera not in known and camera not in self.cameras:  # `require` reports these
                raise SessionError(
                    self._name(path),
                    found="a photograph of a camera that was not calibrated",
                    expected=f"one of {', '.join(sorted(known))}",
                    remedy=_perhaps(camera, sorted(known)) or "Calibrate that camera too, or remove its photograph",
                )
            files = [at for (_, name), at in calibration.items() if name == camera]
            files += [*intrinsics.get(camera, {}).values(), path]
            headers: dict[str, ImageHeader] = {self._name(file): self._header(file) for file in files}
            check_sizes(headers, camera, None if cameras is None else cameras[camera].size_wh)

    def _checked_mask(self, camera: str, path: Path, photograph: Path, digest: str) -> Array:
        width, height = self._header(photograph).size_wh
        size_wh = self._header(path).size_wh
        if size_wh != (width, height):
            remedy = "Export the mask at the photograph's size"
            expected = f"{width} × {height} pixels, as in the photograph of camera {camera}"
            raise ImageError(
                self._name(path), found=f"{size_wh[0]} × {size_wh[1]} pixels", expected=expected, remedy=remedy
            )
        return read_mask(path, self._name(path), self.limits, digest=digest)

    def _header(self, path: Path) -> ImageHeader:
        return read_header(path, self._name(path), self.limits)


def _read_points(path: Path, name: str) -> MeasuredPoints:
    from mammometry.base.photograph import MeasuredPoints

    table = read_table(
        path, name, "a first line id,u,v, then one point per line: its index in the target's list and its pixel"
    )
    values = table.numbers("id", "u", "v")
    for line, value in zip(table.lines, values[:, 0], strict=True):
        if value != round(value):
            remedy = "Correct the table"
            expected = "a whole number: the point's index in the target's list"
            raise SessionError(f"{name}, row {line}, column id", found=f"{value:g}", expected=expected, remedy=remedy)
    return MeasuredPoints(name=name, ids=values[:, 0].astype(np.int64), uv=values[:, 1:].copy())


def _folders(folder: Path) -> list[Path]:
    return [path for path in visible(folder) if path.is_dir()]


def _perhaps(name: str, others: list[str]) -> str | None:
    near = difflib.get_close_matches(name, others, n=1, cutoff=0.6)
    return f"Did you mean {near[0]}? Rename the file, or correct session.toml" if near else None
