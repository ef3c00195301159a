"""Conditions of a session's exposures: cameras at calibration and capture, films, flashes and times."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.geometry import Array, Camera, Float64, Rig, Transform
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.scene import SubjectMotion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureConditions:
    """Cameras, films, flashes and times of a session, rig frame, mm."""

    rig: Rig
    """The cameras at the calibration."""
    capture_rig: Rig
    """The cameras at the capture."""
    lights: Float64[Array, "l 4"]
    """Each flash at the capture: position, and irradiance × mm² at distance 1. 0 if it did not fire."""
    films: Mapping[str, Film]
    """Camera → its lens and sensor."""
    seconds: Mapping[str, float]
    """Camera → time of its exposure relative to the mean of all, s."""
    motion: SubjectMotion | None = None
    """Motion of the subject during the exposures."""

    def with_films(self, change: Callable[[Film], Film]) -> CaptureConditions:
        """The same conditions with changed films of all cameras."""
        return replace(self, films={name: change(film) for name, film in self.films.items()})

    def shift_mm(self, camera: str, points: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """Displacement of the subject's points when a camera is exposed, relative to the mean time of all, mm."""
        if self.motion is None:
            return np.zeros(len(points))
        moved: Float64[Array, " n"] = np.linalg.norm(self.motion.at(points, self.seconds[camera]) - points, axis=1)
        return moved


def plain_exposure(rig: Rig, lights: Float64[Array, "l 4"], film: Film) -> CaptureConditions:
    """Ideal conditions: nothing moves, and equal cameras are exposed together."""
    return CaptureConditions(
        rig=rig,
        capture_rig=rig,
        lights=lights,
        films=dict.fromkeys(rig.cameras, film),
        seconds=dict.fromkeys(rig.cameras, 0.0),
    )


def turned(camera: Camera, rotation_rad: Float64[Array, 3]) -> Camera:
    """The camera rotated about its perspective centre. `rotation_rad`: rotation vector in its own frame."""
    turn = Rotation.from_rotvec(rotation_rad).as_matrix() @ camera.camera_from_world.rotation
    pose = Transform(rotation=turn, translation_mm=-turn @ camera.centre_world)
    return replace(camera, camera_from_world=pose)


def shifted(camera: Camera, shift_mm: Float64[Array, 3]) -> Camera:
    """The camera shifted in the rig's frame, mm."""
    rotation = camera.camera_from_world.rotation.copy()
    centre = camera.centre_world + shift_mm
    return replace(camera, camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre))


def with_cameras(rig: Rig, change: Callable[[Camera], Camera], names: tuple[str, ...] = ()) -> Rig:
    """A rig with some or all of its cameras changed."""
    cameras = {name: change(camera) if name in names or not names else camera for name, camera in rig.cameras.items()}
    return Rig(name=rig.name, cameras=cameras, pair_names=rig.pair_names)
