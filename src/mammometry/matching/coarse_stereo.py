"""Coarse stereo of whole photographs, to separate near objects from the background.

Before the subject is known, both photographs of a pair are reduced, rectified and matched completely, from well in
front of the calibration target's position to far behind it. Where both directions agree, the depth shows whether a
block is in the working volume or behind it, independently of its brightness. Dark or smooth areas remain unknown.
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

# Unless another source is stated, chosen on the simulated captures of docs/decisions/0028.
_SPAN_PX = 270  # approximate longer side of the reduced photographs: a trunk is 100 pixels wide
_NEAREST, _FARTHEST = 0.6, 4.0  # range of depths searched, relative to the working volume's centre
_NEAR, _FAR = 1.25, 1.4  # largest relative depth in the volume, and smallest behind it; in between is unknown
_AGREEMENT_PX = 1.0  # largest difference between both directions, reduced pixels
_AROUND_PX, _TEXTURE = 9, 4.0  # neighbourhood; least variance over noise: a black room has 1 to 4, skin 7 to 60
_SMALLEST_FAR = 0.015  # smallest far part, as a share of the image: smaller ones near the border may match by chance
_POINTS = 1500  # points of a pair that are compared with the silhouettes
_LEAST_COMMON = 0.25  # share of the width that both images show at the nearest depth, if no target was seen
_LEAST_THING, _GAP, _DEPTHS_TRIED = 0.05, 0.1, 60  # least share of near objects, relative gap in depth behind them
_CALM, _LEAST_SURFACE = 0.06, 0.003  # largest relative change of depth within 3 × 3 pixels; least share of the image


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoarseDepths:
    """Depths over both reduced photographs of a pair."""

    step: int
    """Photograph pixels per pixel of these."""
    cameras: tuple[Camera, Camera]
    """The reduced photographs' cameras."""
    ideal: tuple[Camera, Camera]
    """The rectified cameras."""
    depth_mm: tuple[Float32[Array, "h w"], Float32[Array, "h w"]]
    """z of each pixel of the rectified images. NaN where the two directions disagree."""
    textured: Bool[Array, "h w"]
    """Where the left rectified image shows more than noise: black areas match by chance."""

    def middle_mm(self, middle_world: Float64[Array, 3]) -> float:
        """Depth of a point in the rectified images."""
        return float(self.ideal[0].camera_from_world.apply(middle_world[None])[0, 2])


def coarse_depths(rig: Rig, pair_name: str, photographs: tuple[Photograph, Photograph]) -> CoarseDepths | None:
    """Match a pair coarsely.

    None if the photographs do not have their cameras' sizes or cannot be rectified. Matching then raises the error.

    Args:
        rig: the calibrated cameras.
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
    """Point near the subject's centre, world frame, mm.

    It is the mean position of the calibration target. If no target was seen, or nothing is near it, it is the centre of
    the nearest objects that the pairs see. None if they see none.
    """
    held = rig.target_middle_world
    if held is not None and any(np.mean(_is_near(one, held)[0]) >= LEAST_SHARE for one in depths):
        return held
    middles = [middle for middle in map(_nearest_things, depths) if middle is not None]
    return np.median(middles, axis=0) if middles else held


def _nearest_things(depths: CoarseDepths) -> Float64[Array, 3] | None:
    """Median point of the nearest objects with a gap in depth behind them, or of all, world frame, mm."""
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
    """Depths that are continuous over a part of the image. NaN elsewhere, where matches are random."""
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
    """Near and far pixels of both rectified images. A support counts as far."""
    supported: bool
    """Whether the subject is on a board or table."""


def sort_depths(depths: Sequence[CoarseDepths], middle_world: Float64[Array, 3]) -> list[SortedDepths]:
    """Classify all pairs' pixels by depth: near, far, and the support under the subject.

    Args:
        depths: depths of all pairs.
        middle_world: point near the subject's centre, mm.
    """
    nears = [_is_near(one, middle_world) for one in depths]
    supports = find_supports(
        [
            NearDepths(camera=one.ideal[0], depth_mm=one.depth_mm[0], near=cleaned(near[0], 0.0), textured=one.textured)
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
    """Near and far pixels of one image."""
    far = depth > far_mm
    if plane is not None:
        near, lying = parted(depth, near, plane)
        far = far | lying
    return cleaned(near, 0.0), cleaned(far, _SMALLEST_FAR)


def depth_seeds(found: SortedDepths) -> tuple[DepthSeeds, ...]:
    """Near and far blocks of a pair's photographs.

    Returns:
        For the left and the right camera. Empty if too little is near for a decision by depth.
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
    """Some of the points in the working volume that a pair sees reliably, world frame, mm."""
    depths = found.depths
    near = found.sides[0][0] & np.isfinite(depths.depth_mm[0]) & depths.textured
    return _points_world(depths, near)[:: max(1, int(np.count_nonzero(near) / _POINTS))]


def _points_world(depths: CoarseDepths, chosen: Bool[Array, "h w"]) -> Float64[Array, "n 3"]:
    """Points of chosen pixels of the left rectified image."""
    rows, columns = np.nonzero(chosen)
    camera = depths.ideal[0]
    rays = camera.rays_world(np.stack([columns, rows], axis=1).astype(np.float64))
    along = depths.depth_mm[0][rows, columns] / (rays @ camera.axis_world)
    points: Float64[Array, "n 3"] = camera.centre_world + along[:, None] * rays
    return points


def smaller_camera(camera: Camera, step: int) -> Camera:
    """The camera whose pixels are blocks of step × step pixels."""
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
    made = np.rint(means).astype(np.uint16)  # 16 bits keep the precision of the means
    return replace(photograph, pixels=made[..., 0] if made.shape[2] == 1 else made)


def _depths(
    rectified: RectifiedPair, middle_world: Float64[Array, 3] | None
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Depth z of each pixel of both rectified images, mm. NaN where the two directions disagree.

    Without a middle, all depths at which the images share a quarter of their width are searched.
    """
    left, right = rectified.left, rectified.right
    focal = float(left.matrix[0, 0])
    base = float(np.linalg.norm(right.centre_world - left.centre_world))
    columns = float(left.matrix[0, 2] - right.matrix[0, 2])  # the disparity at infinite distance
    if middle_world is None:
        nearest, farthest = (1 - _LEAST_COMMON) * left.size_wh[0], columns
    else:
        middle = float(left.camera_from_world.apply(middle_world[None])[0, 2])
        nearest, farthest = (focal * base / (share * middle) + columns for share in (_NEAREST, _FARTHEST))
    lowest, count = int(np.floor(-nearest)), int(np.ceil(nearest - farthest)) + 2
    levels = [
        Level(image=image.copy(), mask=mask.copy())  # same types as in matching, so that kernels compile once
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
    """Mask of the pixels in areas that vary by more than their noise.

    Around a textured area the neighbourhoods also vary, because they include its border. They are removed, because a
    dark background shows nothing there.
    """
    mean, square, noise = (
        ndimage.uniform_filter(values, _AROUND_PX)
        for values in (image, image**2, checkerboard_residual(image).astype(np.float32) ** 2)
    )
    shown: Bool[Array, "h w"] = ndimage.minimum_filter(square - mean**2 > _TEXTURE * noise, _AROUND_PX)
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
