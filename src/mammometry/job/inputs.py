"""Inputs of a session, and values that several stages share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias

from mammometry.base.errors import CalibrationError
from mammometry.base.notices import Notice, words_of
from mammometry.base.photograph import Photograph
from mammometry.geometry import Array, Bool, Camera, Float64, Rig, TriangleMesh

if TYPE_CHECKING:
    from mammometry.base.photograph import MeasuredPoints
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.calibration.adjust.projection import CameraPrior
    from mammometry.calibration.targets.target import Target
    from mammometry.measure.trunk.body import Mounting
    from mammometry.measure.volume.attribution import Attribution
    from mammometry.measure.volume.uncertainty import EarlierErrors
    from mammometry.surface.repair.repair import RepairedSurface
    from mammometry.surface.texture.texture import TexturedMesh
    from mammometry.walk.region import Region


SubjectKind: TypeAlias = Literal["model", "torso", "surface"]
MISSING = "missing"
"""Digest of a photograph that a pair names but that does not exist yet."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Walk:
    """Region and uncertainty of photographs taken with one telephone while walking around the patient."""

    region: Region
    """Box that contains the body, world frame."""
    scale_std: float
    """Relative standard uncertainty of all lengths."""
    point_std_mm: float
    """Standard uncertainty of a reconstructed point due to the telephone's poses and lens, mm."""
    board_mm: Float64[Array, "2 2"]
    """Lowest and highest corner (x, y) of the board's points, world frame, mm."""
    card_scale: float | None = None
    """True length on the print, measured with a bank card, relative to the stated length. None: no card."""

    @property
    def errors(self) -> tuple[float, ...]:
        """Values of a walk that affect intervals: its uncertainties and the card's size."""
        card = () if self.card_scale is None else (self.card_scale,)
        return (self.scale_std, self.point_std_mm, *card)

    @property
    def key(self) -> str:
        """The walk's region and board, for keys of products."""
        corners = (self.region.low_world, self.region.high_world, self.board_mm)
        return repr([corner.tolist() for corner in corners])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inputs:
    """All inputs of a session. Photographs are read when looked up."""

    rig_name: str
    pair_names: Mapping[str, tuple[str, str]]
    """Pair → names of its left and right camera."""
    subject_kind: SubjectKind
    """``model``: one closed cast. ``torso``: a trunk with both breasts. ``surface``: an open surface, no volume."""
    photographs: Mapping[str, Photograph]
    """Camera → its photograph of the subject."""
    rim_radius_mm: float | None = None
    """Rounding radius of a cast's rim, mm. None if not measured."""
    mounting: Mapping[str, Mounting] = field(default_factory=dict)
    """Camera → how it is mounted. Cameras not listed are upright."""
    target: Target | None
    """The calibration target. None if cameras are given."""
    calibration_photographs: Mapping[tuple[str, str], Photograph]
    """(pose, camera) → photograph of the target."""
    measured_points: Mapping[tuple[str, str], MeasuredPoints] = field(default_factory=dict)
    """(pose, camera) → the target's points in that photograph, measured elsewhere."""
    intrinsics_target: Target | None = None
    """Target of the separate, unsynchronised photographs for each camera's lens. None if there are none."""
    intrinsics_photographs: Mapping[str, Mapping[tuple[str, str], Photograph]] = field(default_factory=dict)
    """Camera → (exposure, camera) → photograph of the intrinsics target."""
    cameras: Mapping[str, Camera] | None = None
    """Given cameras. None: calibrate from the photographs."""
    priors: Mapping[str, CameraPrior] = field(default_factory=dict)
    """Camera → its lens as known before the calibration."""
    masks: Mapping[str, Bool[Array, "h w"]] = field(default_factory=dict)
    """Camera → foreground mask given by the user."""
    boundaries: Mapping[str, Float64[Array, "n 3"]] = field(default_factory=dict)
    """Breast → closed boundary curve given by the user, world frame, mm. Empty: found automatically."""
    automatic: tuple[str, ...] = ()
    """Breasts whose boundary is found automatically, in addition to those that are given."""
    removed: tuple[Literal["left", "right"], ...] = ()
    """Breasts that the user stated to be removed. They are not searched for."""
    head_stated: bool = False
    """Whether the head's direction is stated for a mesh, or shown by the board of a walk. It is then not checked."""
    attributions: Mapping[str, Attribution] = field(default_factory=dict)
    """Breast → who drew its boundary, and who confirmed it."""
    landmarks: Mapping[str, Float64[Array, "k 3"]] = field(default_factory=dict)
    """Landmark (`measure.landmarks.landmarks`) → point or line picked by the user, world frame, mm."""
    scale_std: float | None = None
    """Relative standard uncertainty of all lengths of a scan. None if a calibration gives it."""
    walk: Walk | None = None
    """Facts about a walk with one telephone. None: the photographs are a rig's."""
    wall: TriangleMesh | None = None
    """Measured wall behind the breast, or back of a cast, world frame, mm. None: not measured."""
    digests: Mapping[str, str] = field(default_factory=dict)
    """Digest of each input's content, by name: ``capture/CAMERA``, ``calibration/POSE/CAMERA``,
    ``points/POSE/CAMERA``, ``intrinsics/CAMERA/EXPOSURE``, ``masks/CAMERA``, ``cameras``, ``prior``, ``target``,
    ``intrinsics-target``, ``rig``, ``subject``, ``boundaries``, ``landmarks``, ``wall``. Computed when looked up.
    """

    @property
    def all_removed(self) -> bool:
        """Whether both breasts of a torso are stated to be removed."""
        return len(set(self.removed)) == 2

    @property
    def calibrates(self) -> bool:
        """Whether the cameras are calibrated from photographs of a target, not given.

        Raises:
            CalibrationError: there is neither a target nor a camera.
        """
        if self.cameras is None and self.target is None:
            remedy = "Describe the calibration target, or import cameras with `mammometry import-cameras`"
            raise CalibrationError(
                "session.toml", found="neither a [target] nor ready-made cameras", expected="one of them", remedy=remedy
            )
        return self.cameras is None

    @property
    def all_masks_given(self) -> bool:
        """Whether the user gave a mask for every photograph."""
        return set(self.photographs) <= set(self.masks)

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the calibration target's poses."""
        return tuple(sorted({pose for pose, _ in self.calibration_photographs}))

    def key_part(self, *names: str) -> dict[str, str]:
        """Digests of some inputs, for a product's key. Inputs that the session lacks are left out.

        Args:
            names: as in `digests`; or ``capture`` and ``masks`` for all of them, ``mounting``, ``rim``, ``scale``,
                ``region``, ``walk-errors``.
        """
        part: dict[str, str] = {}
        for name in names:
            if name in ("capture", "masks"):
                members = self.photographs if name == "capture" else self.masks
                part |= self.key_part(*(f"{name}/{camera}" for camera in members))
            elif name in self._plain:
                if (value := self._plain[name]) is not None:
                    part[name] = repr(value)
            elif not self._lacks(name):
                part[name] = self.digests[name]
        return part

    @property
    def _plain(self) -> Mapping[str, object]:
        """Short inputs, which are in the key themselves rather than their digests."""
        return {
            "mounting": sorted(self.mounting.items()) or None,
            "rim": self.rim_radius_mm,
            "scale": self.scale_std,
            "region": None if self.walk is None else self.walk.key,
            "walk-errors": None if self.walk is None else self.walk.errors,
        }

    def _lacks(self, name: str) -> bool:
        folder, _, item = name.partition("/")
        return (
            (name == "wall" and self.wall is None)
            or (name == "prior" and not self.priors)
            or (folder == "masks" and item not in self.masks)
        )

    @property
    def upside_down(self) -> tuple[str, ...]:
        """Cameras that are mounted upside down."""
        return tuple(name for name, mounting in self.mounting.items() if mounting == "upside-down")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSet:
    """A rig, calibrated here or read from a file, with its quality."""

    rig: Rig
    std: Mapping[str, Mapping[str, float]]
    """Camera → parameter → standard deviation. Empty for given cameras."""
    world: str
    """One sentence that defines the world frame."""
    rms_px: float | None
    """Root mean square reprojection error, px. None for given cameras."""
    verdict: str | None = None
    """``pass`` or ``warn`` (`judge.quality`). None for given cameras. A refused calibration gives no cameras."""
    notices: tuple[Notice, ...] = ()
    """Reasons for the verdict, worst first. For given cameras: why their lengths are doubtful."""

    @property
    def reasons(self) -> tuple[str, ...]:
        """The notices as text."""
        return tuple(map(words_of, self.notices))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FinishedSurface:
    """The repaired surface with its photographic colours."""

    repaired: RepairedSurface
    textured: TexturedMesh


def earlier_errors(calibration: Calibration | None) -> EarlierErrors:
    """Errors of a calibration that a volume inherits. Empty without a calibration."""
    import numpy as np

    from mammometry.calibration.judge.expected_error import expected_error
    from mammometry.measure.volume.uncertainty import EarlierErrors

    if calibration is None:
        return EarlierErrors()
    expected = np.concatenate(list(expected_error(calibration).std_mm.values()))
    seen = np.isfinite(expected)
    point_std_mm = float(np.sqrt(np.mean(expected[seen] ** 2))) if seen.any() else None
    return EarlierErrors(scale_std=calibration.scale_std, point_std_mm=point_std_mm)
