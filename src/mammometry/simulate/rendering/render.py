"""Pictures of a scene by ray casting: lens, shading, antialiased edges."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from mammometry.geometry import Array, Bool, Camera, Float32, Int32, Int64
from mammometry.simulate.rendering import kernels, shading
from mammometry.simulate.rendering.registry import BUILT_IN, add_renderer
from mammometry.simulate.rendering.sampling import (
    PINHOLE,
    Aperture,
    disc_offsets,
    lens_parameters,
    lens_rays,
    net_offsets,
    picture_window,
)
from mammometry.simulate.rendering.scene import StudioScene
from mammometry.simulate.rendering.skin import SkinReflectance

_NOTHING = -1  # face number of a ray without a hit
_PLAIN_SAMPLES = 4  # rays per pixel within the subject, through a pinhole
_EDGE_SAMPLES = 16  # rays per pixel on an edge
_UNSHARP_PLAIN_SAMPLES = 16  # rays per pixel within the subject, through a lens's aperture
_UNSHARP_EDGE_SAMPLES = 64  # rays per pixel on an edge, through a lens's aperture
_PLAIN_CONTRAST = 0.2  # mottling of everything except skin, logarithm of lightness; made up
AMBIENT = 0.10
"""Radiance of a white surface under ambient light."""
_STRIP_PIXELS = 150_000  # pixels traced at a time; limits memory
_JUMP = 0.004  # relative difference of range between neighbouring pixels above which there is an edge


@add_renderer(BUILT_IN)
def render_subject(
    scene: StudioScene,
    camera: Camera,
    skin: SkinReflectance,
    *,
    seed: int,
    aperture: Aperture = PINHOLE,
    background: float = 0.0,
) -> Float32[Array, "h w 3"]:
    """Radiance of the scene at the camera before the lens's blur: linear RGB, full scale 1.

    Args:
        scene: lit scene, rig frame.
        camera: camera in the rig's frame.
        skin: appearance of the subject.
        seed: seed of the mottling, the same for all cameras of a capture.
        aperture: aperture of the lens.
        background: radiance of the dark room.
    """
    image = np.full((*camera.shape_hw, 3), background, dtype=np.float32)
    for block in blocks(scene, camera, aperture):
        image[block.row, block.column] = _sampled(scene, camera, skin, block, seed, aperture, background)
    return image


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelBlock:
    """Some pixels that are not empty."""

    row: Int64[Array, " n"]
    column: Int64[Array, " n"]
    is_edge: bool
    """Whether a silhouette, fold or rim may cross the pixels, also by defocus."""
    face: Int32[Array, " n"]
    """First face along the ray of each pixel's centre. −1 for none, or at edges."""
    second: Float32[Array, " n"]
    """Barycentric weight of the face's second vertex."""
    third: Float32[Array, " n"]
    """Barycentric weight of its third vertex."""


def blocks(scene: StudioScene, camera: Camera, aperture: Aperture) -> Iterator[PixelBlock]:
    """Yield all pixels that are not empty, in blocks."""
    top, bottom, left, right = _frame(scene, camera)
    if left >= right:
        return
    height = camera.shape_hw[0]
    spread = math.ceil(_unsharp_px(scene, camera, aperture)) if aperture.diameter_mm else 0
    rows_at_once = max(4, _STRIP_PIXELS // (right - left))
    for start in range(top, bottom, rows_at_once):
        # Some extra rows on either side, so that edges are found across strips.
        rows = slice(max(start - 1 - spread, 0), min(start + rows_at_once + 1 + spread, height))
        window = (rows.start, rows.stop, left, right)
        edge, hit = _edges(scene, camera, window)
        edge |= _hairs(scene, camera, window)
        if spread:
            edge = maximum_filter(edge, 2 * spread + 1)
        body = np.zeros_like(edge)
        body[start - rows.start : min(start + rows_at_once, bottom) - rows.start] = True
        something = hit["primID"].reshape(edge.shape) >= 0
        for mask, is_edge in ((edge & body, True), (something & ~edge & body, False)):
            row, column = np.nonzero(mask)
            place = row * (right - left) + column
            if len(row):
                yield PixelBlock(
                    row=row + rows.start,
                    column=column + left,
                    is_edge=is_edge,
                    face=hit["primID"][place],
                    second=hit["u"][place],
                    third=hit["v"][place],
                )


def sample_rays(
    camera: Camera, row: Int64[Array, " n"], column: Int64[Array, " n"], samples: int, aperture: Aperture
) -> tuple[Float32[Array, "k 3"], Float32[Array, "k 3"]]:
    """Origins and directions of `samples` rays per pixel, through its area and the lens's aperture."""
    offsets = net_offsets(samples)
    uv = np.stack([column[:, None] + offsets[:, 0], row[:, None] + offsets[:, 1]], axis=-1).reshape(-1, 2)
    return _rays(camera, uv, aperture, np.tile(disc_offsets(samples), (len(row), 1)))


def paint_seed(seed: int) -> np.uint64:
    """Seed of the mottling for a capture's seed."""
    return np.uint64(np.random.default_rng([seed, 21]).integers(1 << 63, dtype=np.uint64))


def subject_coverage(scene: StudioScene, camera: Camera, samples: int = 64) -> Float32[Array, "h w"]:
    """Share of each pixel's area that the subject covers, by counting rays: the true silhouette."""
    coverage = np.zeros(camera.shape_hw, dtype=np.float32)
    top, bottom, left, right = _frame(scene, camera)
    row, column = (grid.ravel() for grid in np.mgrid[top:bottom, left:right])
    inside = np.zeros(len(row), dtype=np.float32)
    for offset in net_offsets(samples):
        face, _ = _cast(scene, camera, np.stack([column, row], axis=1) + offset)
        inside += ((face >= 0) & (face < scene.subject_faces)).astype(np.float32) / samples
    coverage[row, column] = inside
    return coverage


def _frame(scene: StudioScene, camera: Camera) -> tuple[int, int, int, int]:
    """Rows and columns (from, to) in which the scene may be, from every tenth vertex of the subject."""
    vertices = scene.mesh.vertices
    few = np.concatenate([vertices[: scene.subject_vertices : 10], vertices[scene.subject_vertices :]])
    return picture_window(camera, few, margin_px=8)


def _unsharp_px(scene: StudioScene, camera: Camera, aperture: Aperture) -> float:
    """Radius of the largest defocus disc of the subject's points, px."""
    depth_mm = camera.camera_from_world.apply(scene.mesh.vertices[: scene.subject_vertices : 10])[:, 2]
    vergence = np.abs(1.0 / np.maximum(depth_mm, 1.0) - 1.0 / aperture.focus_mm)
    return 0.5 * aperture.diameter_mm * float(camera.matrix[0, 0] * vergence.max())


def _rays(
    camera: Camera, uv: Array, aperture: Aperture, places: Array
) -> tuple[Float32[Array, "n 3"], Float32[Array, "n 3"]]:
    directions = np.empty((len(uv), 3), dtype=np.float32)
    uv = np.ascontiguousarray(uv, dtype=np.float64)
    kernels.rays(uv, lens_parameters(camera), camera.camera_from_world.rotation.copy(), directions)
    return lens_rays(camera, directions, aperture, places)


def _cast(scene: StudioScene, camera: Camera, uv: Array) -> tuple[Array, dict[str, Array]]:
    """First face along each pixel position's ray (−1: none), and embree's record of the hit."""
    hit = scene.rays.run(*_rays(camera, uv, PINHOLE, np.zeros((len(uv), 2))), output=True)
    return hit["primID"], hit


def _edges(
    scene: StudioScene, camera: Camera, window: tuple[int, int, int, int]
) -> tuple[Bool[Array, "h w"], dict[str, Array]]:
    """Pixels that a silhouette, fold or rim may cross, and the hit of each pixel's centre."""
    top, bottom, left, right = window
    row, column = np.mgrid[top:bottom, left:right]
    face, hit = _cast(scene, camera, np.stack([column.ravel(), row.ravel()], axis=1))
    piece = np.where(face < 0, _NOTHING, scene.piece[face]).reshape(row.shape)
    distance = np.where(face < 0, 0.0, hit["tfar"]).astype(np.float32).reshape(row.shape)
    with np.errstate(invalid="ignore"):
        jump = maximum_filter(distance, 3) > minimum_filter(distance, 3) * (1.0 + _JUMP)
    edge = (maximum_filter(piece, 3) != minimum_filter(piece, 3)) | jump
    return edge, hit


def _hairs(scene: StudioScene, camera: Camera, window: tuple[int, int, int, int]) -> Bool[Array, "h w"]:
    """Pixels that a hair may cross. Hairs are too thin to be hit by the rays through pixels' centres."""
    top, bottom, left, right = window
    mask = np.zeros((bottom - top, right - left), dtype=bool)
    if not len(scene.strands):
        return mask
    uv = camera.project(scene.strands.reshape(-1, 3).astype(np.float64)).reshape(*scene.strands.shape[:2], 2)
    steps = np.linspace(0.0, 1.0, 1 + math.ceil(float(np.abs(np.diff(uv, axis=1)).max())))[:, None, None, None]
    points = (uv[None, :, :-1] * (1.0 - steps) + uv[None, :, 1:] * steps).reshape(-1, 2)
    column, row = np.rint(points).astype(np.int64).T
    inside = (row >= top) & (row < bottom) & (column >= left) & (column < right)
    mask[row[inside] - top, column[inside] - left] = True
    near: Bool[Array, "h w"] = maximum_filter(mask, 3)
    return near


def _sampled(
    scene: StudioScene,
    camera: Camera,
    skin: SkinReflectance,
    block: PixelBlock,
    seed: int,
    aperture: Aperture,
    background: float,
) -> Float32[Array, "n 3"]:
    """Mean radiance over the squares of some pixels."""
    if aperture.diameter_mm:
        samples, shared = _UNSHARP_EDGE_SAMPLES if block.is_edge else _UNSHARP_PLAIN_SAMPLES, 1
    else:
        samples, shared = (_EDGE_SAMPLES, 1) if block.is_edge else (_PLAIN_SAMPLES, _PLAIN_SAMPLES)
    if shared == 1:
        hit = scene.rays.run(*sample_rays(camera, block.row, block.column, samples, aperture), output=True)
        face, second, third = hit["primID"], hit["u"], hit["v"]
    else:  # on a smooth piece, the face at the pixel's centre is used, and no rays are cast
        face, second, third = block.face, np.repeat(block.second, samples), np.repeat(block.third, samples)
        kernels.in_plane(
            block.row,
            block.column,
            net_offsets(samples),
            lens_parameters(camera),
            camera.camera_from_world.rotation.copy(),
            camera.centre_world,
            scene.mesh.faces,
            scene.vertices,
            face,
            second,
            third,
        )
    colours = np.zeros((len(block.row), 3), dtype=np.float32)
    shading.shade(
        samples,
        shared,
        face,
        second,
        third,
        scene.mesh.faces,
        scene.vertices,
        scene.painted,
        scene.attributes,
        scene.material,
        camera.centre_world,
        float(camera.matrix[0, 0]),
        scene.lights,
        np.array([skin.base_rgb, skin.areola_rgb, *scene.plain_colours]),
        skin.spectrum(),
        skin.sheen(),
        skin.marks(),
        skin.wrap,
        AMBIENT,
        _PLAIN_CONTRAST,
        paint_seed(seed),
        background,
        colours,
    )
    return colours
