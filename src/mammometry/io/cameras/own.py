"""Cameras as cameras.json and as the paper's parameters, and functions shared by all formats."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import json_value, numbers, parsing, read_text, shown, whole
from mammometry.base.registry import Registry
from mammometry.calibration.adjust.projection import LENS_NAMES, CameraPrior
from mammometry.geometry import Array, Camera, Float64, Transform, lens

Reader: TypeAlias = Callable[[Path, Mapping[str, tuple[str, str]]], Mapping[str, Camera]]
"""Reads a file's cameras by name. The session's pairs name the first and second camera of a stereo file."""
READERS: Registry[Reader] = Registry("kind of camera file", package=__package__)
"""Extension of a file with complete cameras → its reader."""

CONVENTION = (
    "x_cam = R x_world + t; then pinhole with K; dist = k1, k2, p1, p2, k3 (OpenCV); pixel centres at integers; mm"
)
_FORMAT = 1  # version of cameras.json
_ROUNDED = 1e-3  # largest deviation from a rotation matrix that is due to truncated digits
_KEYS = {"K", "dist", "R", "t", "image_size"}
_NAME = re.compile(r"(?!\.{1,2}$)[^\x00-\x1f/\\]{1,100}")  # it is also a file's name
_LARGEST_PX = 65_535  # longest side of a JPEG
# focal length relative to the image's longer side: 0.3 for fisheyes, 50 for telescopes
_SHORTEST, _LONGEST = 0.1, 100.0
_SQUARE = 2.0  # largest ratio of both focal lengths; anamorphic lenses have 2
_FARTHEST_MM = 1e5  # largest distance of a camera from the origin: 100 m


def cameras_table(
    cameras: Mapping[str, Camera], std: Mapping[str, Mapping[str, float]] | None = None
) -> dict[str, Any]:
    """Cameras as the plain table of cameras.json.

    ``paper`` contains the paper's eleven parameters, if they describe the camera completely.
    """
    eleven = {name: PaperCamera.of(camera) for name, camera in cameras.items()}
    return {
        "format": _FORMAT,
        "convention": CONVENTION,
        "cameras": {
            name: {
                "image_size": list(camera.size_wh),
                "K": camera.matrix.tolist(),
                "dist": camera.distortion.tolist(),
                "R": camera.camera_from_world.rotation.tolist(),
                "t": camera.camera_from_world.translation_mm.tolist(),
                **({"std": dict(std[name])} if std and name in std else {}),
                **({"paper": paper.as_table()} if (paper := eleven[name]) else {}),
            }
            for name, camera in cameras.items()
        },
    }


def cameras_from_table(table: object, name: str) -> dict[str, Camera]:
    """Read a table written by `cameras_table`. Unknown keys are ignored.

    Raises:
        SessionError: a camera lacks a key, or see `camera_from_entry`.
    """
    entries = table.get("cameras") if isinstance(table, Mapping) else None
    if not isinstance(entries, Mapping) or not entries:
        raise unfit(name, "no table of cameras", "{cameras: {NAME: {K, dist, R, t, image_size}}}")
    cameras = {}
    for camera, entry in entries.items():
        missing = _KEYS - set(entry) if isinstance(entry, Mapping) else _KEYS
        if missing:
            raise unfit(f"{name}, camera {camera}", f"no {', '.join(sorted(missing))}", ", ".join(sorted(_KEYS)))
        cameras[str(camera)] = camera_from_entry(name, str(camera), entry)
    return cameras


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read our own cameras.json.

    Raises:
        SessionError: it cannot be read or is not JSON, a value is missing, or see `require_plausible`.
    """
    return _read(path)[0]


def read_priors(path: Path) -> dict[str, CameraPrior]:
    """Read a cameras.json as priors on lenses, weighted by ``std``.

    Raises:
        SessionError: a standard deviation is invalid, or see `read_cameras`.
    """
    cameras, table = _read(path)
    priors = {}
    for name, camera in cameras.items():
        expected = "std: {fx_px … k3: standard deviation, zero if fixed}"
        with parsing("an invalid prior", f"{path.name}, camera {name}", expected):
            given = table["cameras"][name].get("std", {})
            std = {key: float(numbers(value, 1)[0]) for key, value in given.items() if key in LENS_NAMES}
            priors[name] = CameraPrior(camera=camera, std=std)
    return priors


def _read(path: Path) -> tuple[dict[str, Camera], Any]:
    expected = "JSON as cameras.json has it"
    table = json_value(read_text(path, path.name, expected), path.name, expected)
    cameras = cameras_from_table(table, path.name)
    require_plausible(path.name, cameras)
    return cameras, table


def camera_from_entry(file: str, name: str, entry: Mapping[str, Any]) -> Camera:
    """Make a camera from ``K``, ``dist`` (up to five coefficients), ``R``, ``t`` (mm) and ``image_size``.

    Args:
        file: the file's name in messages.
        name: the camera's name.
        entry: the values, as lists or arrays.

    Raises:
        SessionError: a value has the wrong shape or is not a number, or the values are not a valid camera.
    """
    subject = f"{file}, camera {name}"
    if not _NAME.fullmatch(name):
        raise unfit(file, f"a camera called {shown(name)}", "a name that is valid for a file")
    with parsing("an invalid camera", subject, "K, dist, R, t and image_size of a camera"):
        given = numbers(entry["dist"], -1)
        if np.any(given[5:]):
            raise ValueError(f"{len(given)} distortion coefficients, of which only the first five may be non-zero")
        distortion = np.zeros(5)
        distortion[: min(len(given), 5)] = given[:5]
        width, height = (whole(value) for value in numbers(entry["image_size"], 2))
        rotation = numbers(entry["R"], 3, 3)
        if 1e-9 < np.abs(rotation @ rotation.T - np.eye(3)).max() < _ROUNDED and np.linalg.det(rotation) > 0:
            from scipy.spatial.transform import Rotation

            rotation = Rotation.from_matrix(rotation).as_matrix()
        return Camera(
            name=name,
            size_wh=(width, height),
            matrix=numbers(entry["K"], 3, 3),
            distortion=distortion,
            camera_from_world=Transform(rotation=rotation, translation_mm=numbers(entry["t"], 3)),
        )


def require_plausible(file: str, cameras: Mapping[str, Camera]) -> None:
    """Require plausible cameras, so that typing errors are found before measuring.

    Raises:
        SessionError: the image size, focal length, principal point or distance is implausible, or the lens model folds
        back before the nearer edge of the image.
    """
    for name, camera in cameras.items():
        subject, longest = f"{file}, camera {name}", max(camera.size_wh)
        focal, principal = np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
        away_mm = float(np.abs(camera.centre_world).max())
        if longest > _LARGEST_PX:
            raise unfit(subject, f"an image of {_size(camera)} pixels", f"at most {_LARGEST_PX} in either direction")
        if not ((focal > _SHORTEST * longest) & (focal < _LONGEST * longest)).all():
            expected = f"{_SHORTEST:g} to {_LONGEST:g} times the image's longer side of {longest} pixels"
            raise unfit(subject, f"focal lengths of {focal[0]:g} and {focal[1]:g} pixels", expected)
        if not _SQUARE > focal[0] / focal[1] > 1 / _SQUARE:
            raise unfit(subject, f"focal lengths of {focal[0]:g} and {focal[1]:g} pixels", "nearly square pixels")
        if (np.abs(principal - np.array(camera.size_wh) / 2) > np.array(camera.size_wh)).any():
            found = f"a principal point at u {principal[0]:g}, v {principal[1]:g}"
            raise unfit(subject, found, f"one near the centre of the image of {_size(camera)} pixels")
        if away_mm > _FARTHEST_MM:
            raise unfit(
                subject, f"a position {away_mm:.3g} mm from the origin", f"at most {_FARTHEST_MM:g} mm; check units"
            )
        # The calibration may not have seen the target in the corners, where the lens model is then undetermined.
        edge_xy = float((np.array(camera.size_wh) / (2 * focal)).min())
        fold_xy = lens.fold_xy(camera.distortion)
        if edge_xy > fold_xy:
            found = f"a lens model that folds back at {fold_xy / edge_xy:.0%} of the way to the image's nearer edge"
            raise unfit(subject, found, "one that is valid up to that edge")


def _size(camera: Camera) -> str:
    return f"{camera.size_wh[0]} × {camera.size_wh[1]}"


def camera_name(parts: Sequence[str], known: Collection[str], *, within: bool = False) -> str | None:
    """The session's camera whose name is a part of a path or topic. None if there is none.

    Args:
        parts: parts of the path, such as ``("front_left", "0001.jpg")``. Extensions are ignored.
        known: names of the session's cameras.
        within: whether the name may be a section of a part, as in ``front_left_pose``.
    """
    for part in reversed(parts):
        stem = PurePosixPath(part).stem if part not in known else part
        if stem in known:
            return stem
        if within and (inside := sorted((name for name in known if name in stem), key=len)):
            return inside[-1]
    return None


def pair_of_two(pair_names: Mapping[str, tuple[str, str]]) -> tuple[str, str] | None:
    """Both cameras of a session with one pair, the left one first. Otherwise None."""
    return next(iter(pair_names.values())) if len(pair_names) == 1 else None


def unfit(subject: str, found: str, expected: str) -> SessionError:
    """Return the error for a file that cannot be used."""
    return SessionError(subject, found=found, expected=expected, remedy="Correct the file, or export it again")


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperCamera:
    """A camera by the paper's eleven parameters, C = [α β γ X₀ Y₀ Z₀ x₀ y₀ f μ ν] (paper 2.2).

    The paper states neither the order of its rotations nor the factors of its two distortion terms. Here the rotations
    are about the world's axes, x first, then y, then z (R = R_z(γ) R_y(β) R_x(α)), and μ and ν are Brown's k1 and k2.
    """

    alpha_rad: float
    """First rotation, about the world's x axis."""
    beta_rad: float
    """Second rotation, about its y axis. Between −π/2 and π/2."""
    gamma_rad: float
    """Third rotation, about its z axis."""
    x_mm: float
    """Perspective centre, world frame."""
    y_mm: float
    z_mm: float
    x0_px: float
    """Principal point. Integers are pixel centres."""
    y0_px: float
    f_px: float
    """Focal length, the same along both axes."""
    mu: float
    """Radial distortion: x_distorted = x (1 + μ r² + ν r⁴), with x = X / Z, r² = x² + y². Brown's k1."""
    nu: float
    """Brown's k2."""

    @classmethod
    def of(cls, camera: Camera) -> PaperCamera | None:
        """The camera's eleven parameters. None if it has more: another focal length along y, p1, p2 or k3."""
        f_px, fy_px = float(camera.matrix[0, 0]), float(camera.matrix[1, 1])
        if f_px != fy_px or np.any(camera.distortion[2:]):
            return None
        alpha, beta, gamma = _angles(camera.camera_from_world.rotation)
        x_mm, y_mm, z_mm = camera.centre_world.tolist()
        mu, nu = camera.distortion[:2].tolist()
        return cls(
            alpha_rad=alpha,
            beta_rad=beta,
            gamma_rad=gamma,
            x_mm=x_mm,
            y_mm=y_mm,
            z_mm=z_mm,
            x0_px=float(camera.matrix[0, 2]),
            y0_px=float(camera.matrix[1, 2]),
            f_px=f_px,
            mu=mu,
            nu=nu,
        )

    def camera(self, name: str, size_wh: tuple[int, int]) -> Camera:
        """Our camera with the eleven parameters."""
        rotation = _turn(2, self.gamma_rad) @ _turn(1, self.beta_rad) @ _turn(0, self.alpha_rad)
        return Camera(
            name=name,
            size_wh=size_wh,
            matrix=np.array([[self.f_px, 0.0, self.x0_px], [0.0, self.f_px, self.y0_px], [0.0, 0.0, 1.0]]),
            distortion=np.array([self.mu, self.nu, 0.0, 0.0, 0.0]),
            camera_from_world=Transform(
                rotation=rotation, translation_mm=-rotation @ np.array([self.x_mm, self.y_mm, self.z_mm])
            ),
        )

    def as_table(self) -> dict[str, float]:
        """Names and values, in the paper's order."""
        return asdict(self)


def _turn(axis: int, angle_rad: float) -> Float64[Array, "3 3"]:
    """Rotation about a coordinate axis."""
    one, other = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[one, one] = rotation[other, other] = np.cos(angle_rad)
    rotation[other, one] = np.sin(angle_rad)
    rotation[one, other] = -np.sin(angle_rad)
    return rotation


def _angles(rotation: Float64[Array, "3 3"]) -> tuple[float, float, float]:
    """α, β, γ.

    If β is a right angle, only γ ∓ α is determined. Then γ is determined by rounding, and α is chosen to match it.
    """
    gamma = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    beta = float(np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0])))
    rest = _turn(2, -gamma) @ rotation  # R_y(β) R_x(α): its middle row is 0, cos α, −sin α
    return float(np.arctan2(-rest[1, 2], rest[1, 1])), beta, gamma
