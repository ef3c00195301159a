"""Find which cameras moved: the fewest whose motion makes the sightings agree."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import chdtrc

from mammometry.calibration.adjust.calibrated import ParameterCovariance
from mammometry.calibration.adjust.linear_model import FREE, Fit, LinearModel
from mammometry.calibration.judge.sighting import Sighting, disagreement, moves_of
from mammometry.geometry import Array, Camera, Float64, Transform
from mammometry.geometry.twist import as_motion

Kind: TypeAlias = Literal["shift", "turn", "either", "both"]
"""Motion of a camera: only a displacement, only a rotation about its perspective centre, one of them (the data do not
show which), or certainly both."""
_MOST_SETS = 5000
"""Number of tested sets of cameras after which no larger ones are tested. Twelve cameras have 4,095, which are all
tested."""
_SINGULAR = 1e-14
"""Relative eigenvalue of a covariance below which a direction is undetermined: rounding."""
_SAME = 6
"""Decimals of χ² that are compared. All sets that leave one camera have the same χ², apart from rounding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraMotion:
    """Motion of a camera relative to those that did not move, world frame."""

    motion: Transform
    """Transform from the calibrated to the current camera, of the simplest kind that fits."""
    shift_mm: Float64[Array, 3]
    """Displacement of the perspective centre."""
    turn_rad: Float64[Array, 3]
    """Rotation vector."""
    shift_std_mm: float
    """Largest standard deviation of the displacement over all directions. 0 for a pure rotation."""
    turn_std_rad: float
    """The same of the rotation, rad."""
    kind: Kind
    alone_mm: float
    """Size of the motion if it is only a displacement, mm."""
    alone_rad: float
    """Size of the motion if it is only a rotation, rad."""
    sigma: float
    """Length of the six-parameter motion in its standard errors: 2.3 by chance (median of χ with six degrees of
    freedom). 0 if there is no other camera to compare with."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionProblem:
    """Sightings and the motions that would make them agree. Linear about the placements."""

    seen: tuple[Sighting, ...]
    cameras: tuple[str, ...]
    placed: Mapping[str, Transform]
    """Exposure → approximate placement of the target."""
    model: LinearModel
    """Model of the target's twists, then of the cameras', six unknowns each."""

    @classmethod
    def about(
        cls,
        placed: Mapping[str, Transform],
        seen: Sequence[Sighting],
        cameras: Sequence[str],
        calibrated: ParameterCovariance | None,
        inflation: float,
    ) -> MotionProblem:
        """Linearise about placements of the target.

        Args:
            placed: exposure → placement.
            seen: the sightings.
            cameras: those that may have moved.
            calibrated: covariance of the cameras; None if unknown.
            inflation: factor on the standard deviations of the sightings' own noise.
        """
        moves = moves_of(seen, list(placed), cameras)
        model = disagreement(seen, placed, moves, calibrated, inflation=inflation)
        return cls(seen=tuple(seen), cameras=tuple(cameras), placed=placed, model=model)

    def explanations(self, chance: float) -> list[tuple[str, ...]]:
        """Find the fewest cameras whose motion explains all sightings: several sets, best first, if each does.

        Args:
            chance: probability below which a disagreement is not noise.
        """
        tried = 0
        for count in range(len(self.cameras)):
            found = []
            for moved in combinations(self.cameras, count):
                fit = self._fit(moved)
                tried += 1
                if fit.freedom <= 0 or chdtrc(fit.freedom, fit.misfit) > chance:
                    found.append((round(fit.misfit, _SAME), moved))
            if found:
                return [moved for _, moved in sorted(found)]
            if tried > _MOST_SETS:
                break
        return [self.cameras[1:]]

    def placements(self, moved: Sequence[str]) -> dict[str, Transform]:
        """Exposure → target placement, from the cameras that did not move."""
        twists = self._fit(moved).motions.reshape(-1, 6)
        return {
            pose: as_motion(twist) @ place for twist, (pose, place) in zip(twists, self.placed.items(), strict=False)
        }

    def motion(self, camera: Camera, moved: Sequence[str], chance: float) -> CameraMotion:
        """Motion of a camera relative to those that did not move."""
        fit, own = self._fit({*moved, camera.name}), self._of_camera(camera.name)
        motion = as_motion(-fit.motions[own]).inverse()  # exact for one exposure, however far it moved
        centre = camera.centre_world
        both = np.concatenate([motion.rotation_vector_rad, motion.apply(centre) - centre])
        about_centre = np.eye(6)
        about_centre[3:, :3] = -_cross(centre)
        covariance = about_centre @ fit.covariance[own, own] @ about_centre.T
        std = np.sqrt(np.maximum(np.diag(covariance), np.finfo(np.float64).tiny))
        units = np.outer(std, std)  # radians and millimetres
        information = np.linalg.pinv(covariance / units, rcond=_SINGULAR, hermitian=True) / units
        model = LinearModel(
            matrix=information, right=information @ both, squares=float(both @ information @ both), count=6
        )
        turn, shift = (model.fit(np.repeat(free, 3)) for free in ([FREE, 0.0], [0.0, FREE]))
        fits = [pure for pure in (turn, shift) if chdtrc(3, pure.misfit) > chance]
        best = min(fits, key=lambda pure: pure.misfit) if fits else None
        value, spread = (both, covariance) if best is None else (best.motions, best.covariance)
        kind: Kind = "both" if best is None else "either" if len(fits) > 1 else "turn" if best is turn else "shift"
        return CameraMotion(
            motion=as_motion(value, about=centre),
            shift_mm=value[3:],
            turn_rad=value[:3],
            shift_std_mm=_largest_std(spread[3:, 3:]),
            turn_std_rad=_largest_std(spread[:3, :3]),
            kind=kind,
            alone_mm=float(np.linalg.norm(shift.motions[3:])),
            alone_rad=float(np.linalg.norm(turn.motions[:3])),
            sigma=float(np.sqrt(model.squares)),
        )

    def _of_camera(self, camera: str) -> slice:
        start = 6 * (len(self.placed) + self.cameras.index(camera))
        return slice(start, start + 6)

    def _fit(self, moved: Collection[str]) -> Fit:
        """Fit the target's twists and those of the cameras that moved."""
        std = np.full(len(self.model.right), FREE)
        for camera in self.cameras:
            if camera not in moved:
                std[self._of_camera(camera)] = 0.0
        return self.model.fit(std)


def _cross(vector: Float64[Array, 3]) -> Float64[Array, "3 3"]:
    """Matrix of the vector product from the left."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _largest_std(covariance: Float64[Array, "3 3"]) -> float:
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
