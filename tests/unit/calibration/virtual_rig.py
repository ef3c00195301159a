"""A small virtual rig, its target in several poses, and what the cameras would detect: points only, no pixels."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.points import PointsTarget
from mammometry.calibration.targets.target import Target
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

PAIRS = {"front": ("front_left", "front_right"), "floor": ("floor_left", "floor_right")}
BOARD = ChessboardTarget(squares=(12, 9), square_mm=25.0)
SIZE_WH = (1126, 750)


def looking_at_origin(name: str, centre: Sequence[float], *, focal_px: float, seed: int) -> Camera:
    """A camera with ordinary lens faults whose axis passes near the origin, its x axis horizontal (rig y is down)."""
    rng = np.random.default_rng(seed)
    centre_mm = np.array(centre, float)
    z = -centre_mm / np.linalg.norm(centre_mm)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    rotation = Rotation.from_rotvec(rng.normal(size=3) * 0.01).as_matrix() @ rotation
    matrix = np.array(
        [[focal_px, 0, 563 + rng.normal() * 8], [0, focal_px * 1.0002, 375 + rng.normal() * 8], [0, 0, 1]]
    )
    distortion = np.array([-0.06, 0.1, *rng.normal(size=2) * 2e-4, 0.0])
    return Camera(
        name=name,
        size_wh=SIZE_WH,
        matrix=matrix,
        distortion=distortion,
        camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre_mm),
    )


def cameras_in_rig() -> dict[str, Camera]:
    """Two convergent pairs, 0.8 m from the origin; the frame is the rig's (x right, y down, z away)."""
    return {
        "front_left": looking_at_origin("front_left", (-120, -40, -780), focal_px=2010, seed=1),
        "front_right": looking_at_origin("front_right", (120, -40, -780), focal_px=1990, seed=2),
        "floor_left": looking_at_origin("floor_left", (-110, 480, -620), focal_px=2005, seed=3),
        "floor_right": looking_at_origin("floor_right", (115, 470, -630), focal_px=1995, seed=4),
    }


def shifted(camera: Camera, centre_mm: Sequence[float]) -> Camera:
    """The camera displaced along its own axes."""
    back = Transform(rotation=np.eye(3), translation_mm=-np.array(centre_mm, float))
    return replace(camera, camera_from_world=back @ camera.camera_from_world)


def turned(camera: Camera, degrees: Sequence[float]) -> Camera:
    """The camera turned about its own axes."""
    rotation = Rotation.from_rotvec(np.radians(degrees)).as_matrix()
    return replace(
        camera, camera_from_world=Transform(rotation=rotation, translation_mm=np.zeros(3)) @ camera.camera_from_world
    )


def placements(count: int, *, target: Target = BOARD, seed: int = 0) -> dict[str, Transform]:
    """rig_from_target of a target tilted up to 25° or so, its middle near the origin."""
    rng = np.random.default_rng(seed)
    middle = target.points_target.mean(axis=0)
    found = {}
    for i in range(count):
        tilt = Rotation.from_rotvec([0.35 + rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), rng.uniform(-0.6, 0.6)])
        shift = rng.uniform(-50, 50, size=3)
        found[f"{i:02d}"] = Transform(rotation=tilt.as_matrix(), translation_mm=shift - tilt.apply(middle))
    return found


def see(
    camera: Camera,
    pose: str,
    rig_from_target: Transform,
    points: np.ndarray,
    rng: np.random.Generator,
    *,
    noise_px: float,
    hidden: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Detection:
    """What one camera sees of the points that fall into its frame, with Gaussian noise of known covariance."""
    uv = camera.project(rig_from_target.apply(points))
    inside = np.isfinite(uv).all(axis=1) & (uv > 0).all(axis=1) & (uv < np.array(camera.size_wh) - 1).all(axis=1)
    if hidden is not None:
        inside &= ~hidden(points)
    ids = np.flatnonzero(inside)
    covariance = np.tile(np.eye(2) * max(noise_px, 1e-3) ** 2, (len(ids), 1, 1))
    noise = noise_px * rng.normal(size=(len(ids), 2))
    return Detection(camera=camera.name, pose=pose, ids=ids, uv=uv[ids] + noise, covariance_px2=covariance)


def observe(
    cameras: Mapping[str, Camera],
    rig_from_targets: Mapping[str, Transform],
    *,
    target: Target = BOARD,
    points: np.ndarray | None = None,
    noise_px: float = 0.02,
    seed: int = 0,
    skip: Sequence[tuple[str, str]] = (),
) -> Observations:
    """What all cameras see in all poses, but for the (camera, pose) views in `skip`; `points`: the target as it is."""
    rng = np.random.default_rng(seed)
    points = target.points_target if points is None else points
    return Observations(
        target=target,
        sizes_wh={name: camera.size_wh for name, camera in cameras.items()},
        detections=tuple(
            see(camera, pose, rig_from_target, points, rng, noise_px=noise_px)
            for pose, rig_from_target in sorted(rig_from_targets.items())
            for name, camera in cameras.items()
            if (name, pose) not in skip
        ),
    )


def with_views(observations: Observations, changed: Callable[[Detection], Detection]) -> Observations:
    """The same observations with every detection passed through `changed`."""
    return Observations(
        target=observations.target,
        sizes_wh=observations.sizes_wh,
        detections=tuple(changed(detection) for detection in observations.detections),
    )


def smooth_errors(seed: int, amplitude_px: float) -> Callable[[Detection], Detection]:
    """Errors that a photograph's points share: a random quadratic field for every view, as blur and light make them."""
    rng = np.random.default_rng(seed)

    def changed(detection: Detection) -> Detection:
        x, y = (detection.uv - [563, 375]).T / 400
        field = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1) / np.sqrt(2.5)
        return replace(detection, uv=detection.uv + amplitude_px * field @ rng.normal(size=(6, 2)))

    return changed


def solid_target() -> PointsTarget:
    """Surveyed points on a quarter of a cylinder, the paper's kind of target."""
    angle, height = np.meshgrid(np.linspace(-0.9, 0.9, 12), np.linspace(-110, 110, 16))
    points = np.stack([90 * np.sin(angle), height, 40 - 90 * np.cos(angle)], axis=-1).reshape(-1, 3)
    return PointsTarget(points_mm=tuple((float(x), float(y), float(z)) for x, y, z in points))
