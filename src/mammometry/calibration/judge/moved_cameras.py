"""Find which cameras moved: the fewest whose motion makes the sightings agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import chdtrc

from mammometry.calibration.judge.sighting import Sighting, as_motion
from mammometry.geometry import Array, Camera, Float64, Transform

Kind: TypeAlias = Literal["shift", "turn", "either", "both"]
"""Motion of a camera: displacement, rotation about its perspective centre, either as far as the data show, or certainly
both."""
_MOST_SETS = 5000
"""Sets of cameras that are tried, at most. Chosen by eye."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Motion of a camera against those that stood still, world frame."""

    motion: Transform
    """Transform from the calibrated to the current camera: of the simplest kind that fits."""
    shift_mm: Float64[Array, 3]
    """Displacement of the perspective centre."""
    turn_rad: Float64[Array, 3]
    """Rotation vector."""
    shift_std_mm: float
    """Largest standard deviation of the displacement over all directions. 0 for a pure rotation."""
    turn_std_rad: float
    """Likewise of the rotation."""
    kind: Kind
    alone_mm: float
    """Size of the motion if it was a displacement alone."""
    alone_rad: float
    """Size of the motion if it was a rotation alone."""
    sigma: float
    """Length of the six-parameter motion in its standard errors: 2.3 by chance (median of χ with six degrees of
    freedom). 0 without a camera to compare."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Agreement:
    """Sightings and the motions that would make them agree. Linear about the placements."""

    seen: tuple[Sighting, ...]
    cameras: tuple[str, ...]
    placed: Mapping[str, Transform]
    """Exposure → approximate placement of the target."""
    covariance: Float64[Array, "s s"]
    """Covariance of the sightings' twists, six each, in their order."""

    def explanations(self, chance: float) -> list[tuple[str, ...]]:
        """Find the fewest cameras whose motion explains all. Several sets, best first, where each does.

        Args:
            chance: probability below which a disagreement is not taken for noise.
        """
        tried = 0
        for count in range(len(self.cameras)):
            found = []
            for moved in combinations(self.cameras, count):
                *_, misfit, freedom = self._solved(moved)
                tried += 1
                if freedom <= 0 or chdtrc(freedom, misfit) > chance:
                    found.append((misfit, moved))
            if found:
                return [moved for _, moved in sorted(found)]
            if tried > _MOST_SETS:
                break
        return [self.cameras[1:]]

    def placements(self, moved: Sequence[str]) -> dict[str, Transform]:
        """Exposure → target placement, from the cameras that stood still."""
        unknown = self._solved(moved)[0]
        return {
            pose: as_motion(unknown[6 * i : 6 * i + 6]) @ place for i, (pose, place) in enumerate(self.placed.items())
        }

    def motion(self, camera: Camera, moved: Sequence[str], chance: float) -> Motion:
        """Motion of a camera against those that stood still. The camera itself is not counted among them."""
        others = (*(name for name in moved if name != camera.name), camera.name)
        unknown, covariance, *_ = self._solved(others)
        motion = as_motion(-unknown[-6:]).inverse()  # exact for one exposure, however far it moved
        centre = camera.centre_world
        both = np.concatenate([motion.rotation_vector_rad, motion.apply(centre) - centre])
        about_centre = np.eye(6)
        about_centre[3:, :3] = -_cross(centre)
        covariance = about_centre @ covariance[-6:, -6:] @ about_centre.T
        information = np.linalg.pinv(covariance, rcond=1e-14, hermitian=True)
        turn, shift = (_restricted(both, information, part) for part in (slice(0, 3), slice(3, 6)))
        fits = [pure for pure in (turn, shift) if chdtrc(3, pure.misfit) > chance]
        best = min(fits, key=lambda pure: pure.misfit) if fits else None
        value, spread = (both, covariance) if best is None else (best.value, best.covariance)
        kind: Kind = "both" if best is None else "either" if len(fits) > 1 else "turn" if best is turn else "shift"
        rotation = as_motion(np.concatenate([value[:3], np.zeros(3)])).rotation
        return Motion(
            motion=Transform(rotation=rotation, translation_mm=value[3:] + centre - rotation @ centre),
            shift_mm=value[3:],
            turn_rad=value[:3],
            shift_std_mm=_largest_std(spread[3:, 3:]),
            turn_std_rad=_largest_std(spread[:3, :3]),
            kind=kind,
            alone_mm=float(np.linalg.norm(shift.value)),
            alone_rad=float(np.linalg.norm(turn.value)),
            sigma=float(np.sqrt(both @ information @ both)),
        )

    def _solved(self, moved: Sequence[str]) -> tuple[Float64[Array, " q"], Float64[Array, "q q"], float, int]:
        """Placements, motions of `moved`, covariance, misfit χ², degrees of freedom.

        Placements are the exposures'.
        """
        poses = list(self.placed)
        rows = np.zeros((len(self.seen), len(poses) + len(moved)))
        for i, sighting in enumerate(self.seen):
            rows[i, poses.index(sighting.pose)] = 1.0
            if sighting.camera in moved:
                rows[i, len(poses) + list(moved).index(sighting.camera)] = -1.0
        twists = np.concatenate([sighting.twist_from(self.placed[sighting.pose]) for sighting in self.seen])
        scale = np.sqrt(np.diag(self.covariance))  # radians beside millimetres
        root = np.linalg.cholesky(self.covariance / np.outer(scale, scale) + 1e-12 * np.eye(len(scale)))
        design = np.linalg.solve(root, np.kron(rows, np.eye(6)) / scale[:, None])
        right = np.linalg.solve(root, twists / scale)
        per_unknown = np.maximum(np.linalg.norm(design, axis=0), np.finfo(np.float64).tiny)
        unknown, _, rank, _ = np.linalg.lstsq(design / per_unknown, right, rcond=1e-9)
        misfit = float(np.sum((right - design / per_unknown @ unknown) ** 2))
        normal = (design / per_unknown).T @ (design / per_unknown)
        covariance = np.linalg.pinv(normal, rcond=1e-14, hermitian=True) / np.outer(per_unknown, per_unknown)
        return unknown / per_unknown, covariance, misfit, len(right) - int(rank)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Restricted:
    value: Float64[Array, 6]
    covariance: Float64[Array, "6 6"]
    misfit: float


def _restricted(value: Float64[Array, 6], information: Float64[Array, "6 6"], free: slice) -> _Restricted:
    """Estimate with some numbers held at zero, and its cost in χ²."""
    spread = np.zeros((6, 6))
    spread[free, free] = np.linalg.pinv(information[free, free], rcond=1e-14, hermitian=True)
    fitted = spread @ (information @ value)
    rest = value - fitted
    return _Restricted(value=fitted, covariance=spread, misfit=float(rest @ information @ rest))


def _cross(vector: Float64[Array, 3]) -> Float64[Array, "3 3"]:
    """Matrix of the vector product from the left."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _largest_std(covariance: Float64[Array, "3 3"]) -> float:
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
