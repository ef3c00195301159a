"""Coarse stereo of whole photographs: what is near, what is behind.

Before the subject is known, both photographs of a pair are made small, rectified and matched all over, from well before
the place where the calibration target was held to far behind it. Where both directions agree, the depth says whether a
block lies in the working volume or behind it, whatever its brightness. What is dark or smooth says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from mammometry.base.errors import MatchingError
from mammometry.base.photograph import Photograph
from mammometry.geometry import Array, Bool, Camera, Float32, Float64, Rig, read_only
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.foreground.seeded_segmentation import DepthSeeds
from mammometry.matching.foreground.silhouette import block_means
from mammometry.matching.noise import checkerboard_residual
from mammometry.matching.pyramid import Level
from mammometry.matching.rectify import RectifiedPair, rectify
from mammometry.matching.semiglobal import both_ways
from mammometry.matching.support import (
    LEAST_SHARE,
    LEAST_STANDING,
    NearDepths,
    cleaned,
    find_supports,
    parted,
    reciprocal_depth,
)

# Where no other source is named: chosen on the simulated captures of docs/decisions/0028.
_SPAN_PX = 270  # longer side of the small photographs, about: a trunk is a hundred pixels wide
_NEAREST, _FARTHEST = 0.6, 4.0  # depths searched, of that of the working volume's centre
_NEAR, _FAR = 1.25, 1.4  # nearer than the one is in the volume, beyond the other behind it; in between is not known
_AGREEMENT_PX = 1.0  # of both directions, small pixels
_AROUND_PX, _TEXTURE = 9, 4.0  # variance over noise, around a pixel: a black room has 1 to 4, skin 7 to 60
_SMALLEST_FAR = 0.015  # of the picture: beside the frame, where the partner's ends, small parts match by chance
_POINTS = 1500  # of a pair that the silhouettes are compared with
_LEAST_COMMON = 0.25  # of the pictures' width, at the nearest depth searched where no target was seen; by eye
_LEAST_THING, _GAP, _DEPTHS_TRIED = 0.05, 0.1, 60  # of what is known: nearest things, the gap behind them; by eye
_CALM, _LEAST_SURFACE = 0.06, 0.003  # relative change of depth within 3 × 3 pixels; of the picture; by eye


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoarseDepths:
    """Depths all over both photographs of a pair, made small."""

    step: int
    """Pixels of the photographs to one of these."""
    cameras: tuple[Camera, Camera]
    """The photographs' own, made small."""
    ideal: tuple[Camera, Camera]
    """Rectified."""
    depth_mm: tuple[Float32[Array, "h w"], Float32[Array, "h w"]]
    """z of each pixel of the rectified pictures. NaN where both directions do not agree."""
    textured: Bool[Array, "h w"]
    """Where the left rectified picture shows more than noise: in black, matches agree by chance."""

    def middle_mm(self, middle_world: Float64[Array, 3]) -> float:
        """Depth of a point in the rectified pictures."""
        return float(self.ideal[0].camera_from_world.apply(middle_world[None])[0, 2])


def coarse_depths(rig: Rig, pair_name: str, photographs: tuple[Photograph, Photograph]) -> CoarseDepths | None:
    """Match a pair coarsely.

    None where the photographs have not their cameras' sizes or cannot be rectified: matching then says why.

    Args:
        rig: calibrated cameras.
        pair_name: one of its pairs.
        photographs: its left and right ones.
    """
    pair = rig.pair(pair_name)
    if [photograph.size_wh for photograph in photographs] != [pair.left.size_wh, pair.right.size_wh]:
        return None
    step = max(1, round(max(pair.left.size_wh) / _SPAN_PX))
    cameras = smaller_camera(pair.left, step), smaller_camera(pair.right, step)
    left, right = (_smaller(photograph, step) for photograph in photographs)
    everything = [
        Foreground(
            camera=camera.name, coverage=np.ones(camera.shape_hw, dtype=np.float32), contour_level=0.5, everything=True
        )
        for camera in cameras
    ]
    small = replace(pair, left=cameras[0], right=cameras[1])
    try:
        rectified = rectify(small, left, right, everything[0], everything[1], middle_world=rig.target_middle_world)
    except MatchingError:
        return None
    return CoarseDepths(
        step=step,
        cameras=cameras,
        ideal=(rectified.left, rectified.right),
        depth_mm=_depths(rectified, rig.target_middle_world),
        textured=_textured(rectified.left_image),
    )


def subject_middle(rig: Rig, depths: Sequence[CoarseDepths]) -> Float64[Array, 3] | None:
    """Point about which the subject stands, world frame, mm.

    It is where the calibration target was held. Where no target was seen, or nothing is near its places, it is in the
    middle of the nearest things that the pairs see. None where they see none.
    """
    held = rig.target_middle_world
    if held is not None and any(np.mean(_is_near(one, held)[0]) >= LEAST_SHARE for one in depths):
        return held
    middles = [middle for middle in map(_nearest_things, depths) if middle is not None]
    return np.median(middles, axis=0) if middles else held


def _nearest_things(depths: CoarseDepths) -> Float64[Array, 3] | None:
    """Median point of the nearest things with a gap in depth behind them, else of all, world frame, mm."""
    depth = _of_surfaces(depths.depth_mm[0])
    known = np.sort(depth[np.isfinite(depth)])
    if len(known) < LEAST_SHARE * depth.size:
        return None
    ends = known[int(_LEAST_THING * len(known))] * np.geomspace(1.0, _FARTHEST / _NEAREST, _DEPTHS_TRIED)
    before, within = np.searchsorted(known, ends), np.searchsorted(known, _FAR / _NEAR * ends)
    gaps = np.flatnonzero((within - before < _GAP * before) & (before >= _LEAST_THING * len(known)))
    farthest = ends[gaps[0]] if len(gaps) else np.inf
    return np.median(_points_world(depths, depth < farthest), axis=0)


def _of_surfaces(depth: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """The depths that go on from pixel to pixel over a part of the picture. NaN elsewhere, where chance matched."""
    logs = np.log(depth)
    known = np.isfinite(logs)
    highest = ndimage.maximum_filter(np.where(known, logs, np.inf), 3)
    lowest = ndimage.minimum_filter(np.where(known, logs, -np.inf), 3)
    with np.errstate(invalid="ignore"):
        calm = highest - lowest < _CALM
    labels, count = ndimage.label(calm)
    large = np.bincount(labels.ravel(), minlength=count + 1) >= _LEAST_SURFACE * depth.size
    large[0] = False
    return np.where(large[labels], depth, np.float32(np.nan))


def _is_near(depths: CoarseDepths, middle_world: Float64[Array, 3]) -> list[Bool[Array, "h w"]]:
    return [depth < _NEAR * depths.middle_mm(middle_world) for depth in depths.depth_mm]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SortedDepths:
    """A pair's pixels, sorted by depth."""

    depths: CoarseDepths
    sides: tuple[tuple[Bool[Array, "h w"], Bool[Array, "h w"]], tuple[Bool[Array, "h w"], Bool[Array, "h w"]]]
    """Near and far pixels of both rectified pictures. What lies on a support is far."""
    supported: bool
    """Whether the subject lies on a board or table."""


def sort_depths(depths: Sequence[CoarseDepths], middle_world: Float64[Array, 3]) -> list[SortedDepths]:
    """Sort all pairs' pixels by depth: near, far, and the support under the subject.

    Args:
        depths: of all pairs.
        middle_world: about which the subject stands, mm.
    """
    nears = [_is_near(one, middle_world) for one in depths]
    supports = find_supports(
        [
            NearDepths(camera=one.ideal[0], depth_mm=one.depth_mm[0], near=cleaned(near[0], 0.0))
            for one, near in zip(depths, nears, strict=True)
        ]
    )
    found = []
    for one, near, support in zip(depths, nears, supports, strict=True):
        far_mm = _FAR * one.middle_mm(middle_world)
        left, right = (
            _side(depth, here, far_mm, None if support is None else reciprocal_depth(support, camera))
            for depth, here, camera in zip(one.depth_mm, near, one.ideal, strict=True)
        )
        found.append(SortedDepths(depths=one, sides=(left, right), supported=support is not None))
    return found


def _side(
    depth: Float32[Array, "h w"], near: Bool[Array, "h w"], far_mm: float, plane: Float64[Array, 3] | None
) -> tuple[Bool[Array, "h w"], Bool[Array, "h w"]]:
    """Near and far pixels of one picture."""
    far = depth > far_mm
    if plane is not None:
        near, lying = parted(depth, near, plane)
        far = far | lying
    return cleaned(near, 0.0), cleaned(far, _SMALLEST_FAR)


def depth_seeds(found: SortedDepths) -> tuple[DepthSeeds, ...]:
    """Near and far blocks of a pair's photographs.

    Returns:
        For the left and for the right camera. Nothing where too little is near for depth to tell.
    """
    depths = found.depths
    seeds = []
    for (near, far), camera, ideal in zip(found.sides, depths.cameras, depths.ideal, strict=True):
        at = _places(camera, ideal)
        one = DepthSeeds(camera=camera.name, step=depths.step, near=_looked_up(near, at), far=_looked_up(far, at))
        if one.near.mean() < (LEAST_STANDING if found.supported else LEAST_SHARE):
            return ()
        seeds.append(one)
    return tuple(seeds)


def near_points(found: SortedDepths) -> Float64[Array, "n 3"]:
    """Some of the points in the working volume that a pair sees for certain, world frame, mm."""
    depths = found.depths
    near = found.sides[0][0] & np.isfinite(depths.depth_mm[0]) & depths.textured
    return _points_world(depths, near)[:: max(1, int(np.count_nonzero(near) / _POINTS))]


def _points_world(depths: CoarseDepths, chosen: Bool[Array, "h w"]) -> Float64[Array, "n 3"]:
    """Points of chosen pixels of the left rectified picture."""
    rows, columns = np.nonzero(chosen)
    camera = depths.ideal[0]
    rays = camera.rays_world(np.stack([columns, rows], axis=1).astype(np.float64))
    along = depths.depth_mm[0][rows, columns] / (rays @ camera.axis_world)
    points: Float64[Array, "n 3"] = camera.centre_world + along[:, None] * rays
    return points


def smaller_camera(camera: Camera, step: int) -> Camera:
    """The camera whose pixels are whole blocks of step × step pixels."""
    matrix = camera.matrix.copy()
    matrix[:2, :2] /= step
    matrix[:2, 2] = (matrix[:2, 2] + 0.5) / step - 0.5
    width, height = camera.size_wh
    return replace(camera, size_wh=(width // step, height // step), matrix=matrix)


def _smaller(photograph: Photograph, step: int) -> Photograph:
    pixels = np.atleast_3d(photograph.pixels)
    height, width = (size // step * step for size in pixels.shape[:2])
    largest = np.iinfo(pixels.dtype).max
    levels = np.linspace(0, 65535, largest + 1, dtype=np.float32)
    means = block_means(read_only(pixels[:height, :width].copy()), levels, step)
    made = np.rint(means).astype(np.uint16)  # 16 bits keep what the means gained over the noise
    return replace(photograph, pixels=made[..., 0] if made.shape[2] == 1 else made)


def _depths(
    rectified: RectifiedPair, middle_world: Float64[Array, 3] | None
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Depth z of each pixel of both rectified pictures, mm.

    NaN where both directions do not agree. Without a middle all depths are searched at which the pictures share a
    quarter of their width.
    """
    left, right = rectified.left, rectified.right
    focal = float(left.matrix[0, 0])
    base = float(np.linalg.norm(right.centre_world - left.centre_world))
    columns = float(left.matrix[0, 2] - right.matrix[0, 2])  # the disparity of what is infinitely far
    if middle_world is None:
        nearest, farthest = (1 - _LEAST_COMMON) * left.size_wh[0], columns
    else:
        middle = float(left.camera_from_world.apply(middle_world[None])[0, 2])
        nearest, farthest = (focal * base / (share * middle) + columns for share in (_NEAREST, _FARTHEST))
    lowest, count = int(np.floor(-nearest)), int(np.ceil(nearest - farthest)) + 2
    levels = [
        Level(image=image.copy(), mask=mask.copy())  # as the matching has them: one type for each kernel
        for image, mask in ((rectified.left_image, rectified.left_mask), (rectified.right_image, rectified.right_mask))
    ]
    here, there = both_ways(levels[0], levels[1], lowest, count)
    found = []
    for shift, other, mask, sign in ((here, there, levels[0].mask, -1), (there, here, levels[1].mask, 1)):
        column = np.arange(shift.shape[1]) + shift
        partner = np.clip(np.rint(column), 0, other.shape[1] - 1).astype(np.intp)
        agreed = mask & (np.abs(shift + np.take_along_axis(other, partner, axis=1)) <= _AGREEMENT_PX)
        parallax = sign * shift - columns
        known = agreed & (column > -0.5) & (column < other.shape[1] - 0.5) & (parallax > 0)
        found.append(np.where(known, focal * base / np.where(known, parallax, 1), np.nan).astype(np.float32))
    return found[0], found[1]


def _textured(image: Float32[Array, "h w"]) -> Bool[Array, "h w"]:
    """Where a picture varies by more than its noise does, which its checkerboard pattern shows."""
    mean, square, noise = (
        ndimage.uniform_filter(values, _AROUND_PX)
        for values in (image, image**2, checkerboard_residual(image).astype(np.float32) ** 2)
    )
    shown: Bool[Array, "h w"] = square - mean**2 > _TEXTURE * noise
    return shown


def _places(camera: Camera, ideal: Camera) -> tuple[Array, Array, Bool[Array, "h w"]]:
    """Rectified row and column of each pixel of a photograph, with mask."""
    height, width = camera.shape_hw
    uv = np.stack(np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)), axis=2)
    places = np.rint(ideal.project(ideal.centre_world + camera.rays_world(uv)))
    limits = np.array(ideal.size_wh)
    with np.errstate(invalid="ignore"):
        there = ((places >= 0) & (places < limits)).all(axis=2)
    whole = np.where(there[..., None], places, 0).astype(np.intp)
    return whole[..., 1], whole[..., 0], there


def _looked_up(mask: Bool[Array, "h w"], at: Sequence[Array]) -> Bool[Array, "H W"]:
    found: Bool[Array, "H W"] = mask[at[0], at[1]] & at[2]
    return found
