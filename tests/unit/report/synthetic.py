"""Small synthetic values of every stage: a ball photographed by two pairs of cameras, exact where it can be."""

from __future__ import annotations

import numpy as np
import trimesh

from mammometry.base.notices import Notice
from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.calibrated import Calibration, ParameterCovariance
from mammometry.calibration.adjust.left_out import LeftOut
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.matching.dense.match import DisparityMap
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.quality import MatchQuality
from mammometry.matching.quality import assess as assess_match
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.figures.stage_results import MeasureResult
from mammometry.surface.ranges.dents import ValidPatches
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.surface.repair.repair import Provenance, RepairedSurface
from mammometry.surface.texture.texture import TexturedMesh

RADIUS_MM = 60.0
DISTANCE_MM = 800.0
SIZE_WH = (240, 160)


def look_at_origin(name: str, azimuth_rad: float, x_mm: float = 0.0) -> Camera:
    """A camera on a level circle around the origin, shifted sideways by `x_mm`; world y is down."""
    forward = np.array([np.sin(azimuth_rad), 0.0, np.cos(azimuth_rad)])
    down = np.array([0.0, 1.0, 0.0])
    right = np.cross(down, forward)
    rotation = np.stack([right, down, forward])
    centre = -DISTANCE_MM * forward + x_mm * right
    width, height = SIZE_WH
    matrix = np.array([[1000.0, 0.0, (width - 1) / 2], [0.0, 1000.0, (height - 1) / 2], [0.0, 0.0, 1.0]])
    return Camera(
        name=name,
        size_wh=SIZE_WH,
        matrix=matrix,
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre),
    )


def rig() -> Rig:
    """Two pairs that look at the origin from −20° and +20°."""
    cameras = {
        f"{pair}_{side}": look_at_origin(f"{pair}_{side}", azimuth, x_mm)
        for pair, azimuth in (("one", -0.35), ("two", 0.35))
        for side, x_mm in (("left", -50.0), ("right", 50.0))
    }
    return Rig(
        name="small", cameras=cameras, pair_names={pair: (f"{pair}_left", f"{pair}_right") for pair in ("one", "two")}
    )


def range_of_ball(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Exact distance to the ball at the origin along each pixel's ray, and where it is met."""
    height, width = camera.shape_hw
    rays = camera.rays_world(np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1))
    along = -(rays @ camera.centre_world)
    root = along**2 - (camera.centre_world @ camera.centre_world - RADIUS_MM**2)
    hit = root > 0
    return np.where(hit, along - np.sqrt(np.maximum(root, 0)), 0).astype(np.float32), hit


def photographs(cameras: Rig) -> dict[str, Photograph]:
    """A pale ball before black."""
    pictures = {}
    for name, camera in cameras.cameras.items():
        _, hit = range_of_ball(camera)
        pixels = np.where(hit[..., None], np.array([205, 160, 140]), 8).astype(np.uint8)
        pictures[name] = Photograph(name=f"capture/{name}.png", pixels=pixels)
    return pictures


def foregrounds(cameras: Rig, *, everything: bool = False) -> dict[str, Foreground]:
    return {
        name: Foreground(
            camera=name,
            coverage=np.ones(camera.shape_hw, np.float32)
            if everything
            else range_of_ball(camera)[1].astype(np.float32),
            contour_level=0.5,
            everything=everything,
        )
        for name, camera in cameras.cameras.items()
    }


def disparities(cameras: Rig, *, d_v_px: float = 0.0) -> dict[str, DisparityMap]:
    """Exact disparities of the ball; the cameras are parallel, so they are rectified already."""
    maps = {}
    for pair in cameras.pairs:
        distance, hit = range_of_ball(pair.left)
        height, width = pair.left.shape_hw
        grid = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1)
        points = pair.left.centre_world + pair.left.rays_world(grid) * distance[..., None]
        d_h = np.where(hit, grid[..., 0] - pair.right.project(points)[..., 0], 0).astype(np.float32)
        constant = np.float32
        maps[pair.name] = DisparityMap(
            name=pair.name,
            left=pair.left,
            right=pair.right,
            d_h_px=d_h,
            d_v_px=np.where(hit, constant(d_v_px), constant(0)),
            confidence=np.where(hit, constant(0.9), constant(0)),
            sigma_px=np.where(hit, constant(0.05), constant(0)),
            valid=hit,
            weak=np.zeros_like(hit),
        )
    return maps


def matching(cameras: Rig, *, d_v_px: float = 0.0) -> dict[str, MatchQuality]:
    """How well the ball is matched."""
    return {name: assess_match(found) for name, found in disparities(cameras, d_v_px=d_v_px).items()}


def ranges(cameras: Rig) -> dict[str, RangeImage]:
    images = {}
    for pair in cameras.pairs:
        distance, hit = range_of_ball(pair.left)
        flat = np.where(hit, np.float32(0.1), np.float32(0))
        images[pair.name] = RangeImage(
            name=pair.name, camera=pair.left, range_mm=distance, sigma_mm=flat, confidence=flat, valid=hit
        )
    return images


def valid(images: dict[str, RangeImage]) -> ValidPatches:
    """All but the top tenth of every image."""
    kept = []
    for image in images.values():
        keep = np.ones(image.valid.shape, dtype=bool)
        keep[: image.valid.shape[0] // 2] = False
        kept.append(image.keeping(keep))
    angles = tuple(np.zeros(image.valid.shape, dtype=np.float32) for image in kept)
    return ValidPatches(range_images=tuple(kept), angles_rad=angles)


def ball(subdivisions: int = 4) -> TriangleMesh:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS_MM)
    return TriangleMesh(
        vertices=np.asarray(mesh.vertices, dtype=np.float64), faces=np.asarray(mesh.faces, dtype=np.int32)
    )


def repaired(mesh: TriangleMesh) -> RepairedSurface:
    """Measured towards the cameras (negative z), repaired and bridged in rings, invented behind."""
    z = mesh.vertices[:, 2]
    provenance = np.select(
        [z < 0, z < 0.25 * RADIUS_MM, z < 0.5 * RADIUS_MM],
        [Provenance.MEASURED, Provenance.REPAIRED, Provenance.BRIDGED],
        Provenance.INVENTED,
    ).astype(np.uint8)
    measured = provenance == Provenance.MEASURED
    return RepairedSurface(
        mesh=mesh,
        provenance=provenance,
        sigma_mm=np.where(measured, np.float32(0.1), np.float32(np.nan)),
        pair_bits=measured.astype(np.int32) * 3,
        pair_names=("one", "two"),
        convergence=np.array([0.4, 0.05]),
    )


def textured(mesh: TriangleMesh) -> TexturedMesh:
    return TexturedMesh(mesh=mesh, colours=np.full((len(mesh.vertices), 3), (205, 160, 140), dtype=np.uint8))


def half_ball(n: int = 48) -> tuple[TriangleMesh, np.ndarray, int]:
    """The half of the ball towards the cameras, closed by a plane: mesh, boundary, number of skin faces."""
    rings = n // 4
    rows = [np.array([[0.0, 0.0, -RADIUS_MM]])]
    azimuth = 2 * np.pi * np.arange(n) / n
    for k in range(1, rings + 1):
        polar = np.pi / 2 * k / rings
        rows.append(
            RADIUS_MM
            * np.stack(
                [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.full(n, -np.cos(polar))], axis=1
            )
        )
    faces = [(0, 1 + (k + 1) % n, 1 + k) for k in range(n)]
    for ring in range(rings - 1):
        low, high = 1 + ring * n, 1 + (ring + 1) * n
        for k in range(n):
            after = (k + 1) % n
            faces += [(low + k, low + after, high + k), (low + after, high + after, high + k)]
    skin = len(faces)
    vertices = np.concatenate([*rows, np.zeros((1, 3))])
    last, middle = 1 + (rings - 1) * n, len(vertices) - 1
    faces += [(last + k, last + (k + 1) % n, middle) for k in range(n)]
    mesh = TriangleMesh(vertices=vertices, faces=np.array(faces, dtype=np.int32))
    return mesh, vertices[last : last + n].copy(), skin


def measurement(name: str = "model", *, interval_cc: tuple[float, float] | None = None) -> VolumeMeasurement:
    closed, boundary, skin = half_ball()
    areas = np.linalg.norm(closed.face_vectors(), axis=1)
    return VolumeMeasurement(
        name=name,  # type: ignore[arg-type]
        volume_cc=closed.volume_mm3() / 1000,
        interval_cc=interval_cc,
        interval_terms_cc={"wall": 3.0} if interval_cc else {},
        interval_note="covers the wall alone" if interval_cc else "none is known",
        closed=closed,
        skin_faces=skin,
        watertight=closed.is_watertight(),
        wall_kind="plane",
        wall_definition="the plane through the boundary",
        boundary_world=boundary,
        boundary_method="the equator",
        alternatives_cc={"membrane": 450.0},
        base_area_cm2=float(areas[skin:].sum()) / 100,
        projection_mm=RADIUS_MM,
        area_cm2=float(areas[:skin].sum()) / 100,
    )


def measured(cameras: Rig, measurements: list[VolumeMeasurement], mesh: TriangleMesh) -> MeasureResult:
    """What the pictures of the measurement are drawn from."""
    return MeasureResult(rig=cameras, measurements=measurements, textured=textured(mesh))


def calibration(cameras: Rig, *, noise_px: float = 0.05) -> Calibration:
    """A board in three poses, seen with Gaussian noise; the cameras are the true ones."""
    target = CharucoTarget(squares=(7, 5), square_mm=18.0, marker_mm=13.0, dictionary="DICT_4X4_50")
    points = target.points_target
    generator = np.random.default_rng(5)
    placements = {
        f"{k:02d}": Transform.from_rotation_vector(
            np.array([0.3 * (k - 1), 0.2 * (1 - k), 0.0]), -points.mean(axis=0) + (0, 0, 15.0 * k)
        )
        for k in range(3)
    }
    detections, residuals = [], []
    for pose, world_from_target in placements.items():
        for name, camera in cameras.cameras.items():
            exact = camera.project(world_from_target.apply(points))
            inside = ((exact >= 0) & (exact <= np.array(SIZE_WH) - 1)).all(axis=1)
            error = generator.normal(0, noise_px, (int(inside.sum()), 2))
            detections.append(
                Detection(
                    camera=name,
                    pose=pose,
                    ids=np.flatnonzero(inside),
                    uv=exact[inside] + error,
                    covariance_px2=np.tile(np.eye(2) * noise_px**2, (int(inside.sum()), 1, 1)),
                )
            )
            left_out = error.copy()
            left_out[0] = np.nan
            residuals.append(-left_out)
    observations = Observations(
        target=target, sizes_wh={name: SIZE_WH for name in cameras.cameras}, detections=tuple(detections)
    )
    every = np.concatenate(residuals)
    return Calibration(
        rig=cameras,
        world="The board in pose 00.",
        world_from_target=placements,
        target_points=points,
        observations=observations,
        residuals_px=tuple(residuals),
        intrinsics_observations={},
        intrinsics_residuals_px={},
        rms_px=float(np.sqrt(np.nanmean((every**2).sum(axis=1)))),
        noise_factor=1.0,
        parameter_std={name: {"fx_px": 0.1, "fy_px": 0.1} for name in cameras.cameras},
        independent_std={name: {"fx_px": 0.1, "fy_px": 0.1} for name in cameras.cameras},
        covariance=ParameterCovariance(
            names=tuple(f"{name}.fx_px" for name in cameras.cameras),
            matrix=0.01 * np.eye(len(cameras.cameras)),
            independent=0.01 * np.eye(len(cameras.cameras)),
        ),
        scale_std=None,
        left_out=LeftOut(poses=len(placements), fitted_px=0.1, left_out_px=0.102, chance_ratio=1.01),
        set_aside=(),
        iterations=3,
        converged=True,
    )


def sentence_notice(text: str) -> Notice:
    """A notice in these words."""
    return Notice(code="sentence", values={"text": text})
