"""Coarse stereo of whole photographs: what is near, what is behind.

Before the subject is known, both photographs of a pair are made small, rectified and matched all over, from well before
the place where the rig's optical axes meet to far behind it. Where both directions agree, the depth says whether a
block lies in the working volume or behind it, whatever its brightness. What is dark or smooth says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from mammometry.base.errors import MatchingError
from mammometry.base.photograph import Photograph
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, read_only
from mammometry.geometry.camera import Camera, Rig, StereoPair
from mammometry.matching.first_disparities import both_ways
from mammometry.matching.foreground import Foreground
from mammometry.matching.pyramid import Level
from mammometry.matching.rectify import RectifiedPair, rectify
from mammometry.matching.seeded import DepthSeeds
from mammometry.matching.silhouette import block_means

# Where no other source is named: chosen on the simulated captures of docs/decisions/0028.
_SPAN_PX = 270  # longer side of the small photographs, about: a trunk is a hundred pixels wide
_NEAREST, _FARTHEST = 0.6, 4.0  # depths searched, of that of the working volume's centre
_NEAR, _FAR = 1.25, 1.4  # nearer than the one is in the volume, beyond the other behind it; in between is not known
_AGREEMENT_PX = 1.0  # of both directions, small pixels
_SMALLEST_PART = 0.02  # of the largest part: smaller ones are chance
_SMALLEST_FAR = 0.015  # of the picture: beside the frame, where the partner's ends, small parts match by chance
_LEAST_SHARE = 0.02  # of the picture that must be near for a pair to say anything
_FLATNESS = 0.012  # of the depth: what is nearer to a plane lies on it; a pixel of disparity, and a tenth of a cast
_STANDING = 1.5  # times that: what certainly stands before it
_BOARD, _ON_BOARD, _BELOW = 0.5, 0.03, 0.4  # of what is near: on a board; before it; behind it, of what is before it
_SOME, _TRIALS, _LEAST_AREA, _DRAWN = 1500, 150, 0.02, 28  # points and planes tried, their size of the picture, seed
_FITS = 3  # least squares on what lies on the plane
_LEAST_ANGLE = 0.05  # sine between optical axes, root mean square: nearly parallel ones meet nowhere


def working_centre(rig: Rig) -> Float64[Array, 3] | None:
    """Point nearest to all optical axes (least squares), world frame, mm.

    None where they are nearly parallel, or where it lies behind a camera.
    """
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for camera in rig.cameras.values():
        across = np.eye(3) - np.outer(camera.axis_world, camera.axis_world)
        normal += across
        right += across @ camera.centre_world
    if np.linalg.eigvalsh(normal)[0] < len(rig.cameras) * _LEAST_ANGLE**2:
        return None
    centre: Float64[Array, 3] = np.linalg.solve(normal, right)
    ahead = [float(camera.axis_world @ (centre - camera.centre_world)) for camera in rig.cameras.values()]
    return centre if min(ahead) > 0 else None


def depth_seeds(rig: Rig, pair_name: str, photographs: tuple[Photograph, Photograph]) -> tuple[DepthSeeds, ...]:
    """Match a pair coarsely, and sort its blocks by depth.

    Args:
        rig: calibrated cameras.
        pair_name: one of its pairs.
        photographs: its left and right ones.

    Returns:
        For the left and for the right camera; nothing where depth cannot tell: where the rig has no working volume,
        where too little is near, and where the pair cannot be rectified (matching then says why).
    """
    pair, centre_world = rig.pair(pair_name), working_centre(rig)
    sizes = [photograph.size_wh for photograph in photographs]
    if centre_world is None or sizes != [pair.left.size_wh, pair.right.size_wh]:
        return ()
    try:
        return _seeds(pair, photographs, centre_world)
    except MatchingError:
        return ()


def seeds_of_cameras(rig: Rig, photographs: Mapping[str, Photograph]) -> dict[str, list[DepthSeeds]]:
    """Camera → its seeds by each pair that it is in.

    See `depth_seeds`. `photographs` are of both cameras of each.
    """
    found: dict[str, list[DepthSeeds]] = {name: [] for name in photographs}
    for pair, (left, right) in rig.pair_names.items():
        for one in depth_seeds(rig, pair, (photographs[left], photographs[right])):
            found[one.camera].append(one)
    return found


def _seeds(
    pair: StereoPair, photographs: tuple[Photograph, Photograph], centre_world: Float64[Array, 3]
) -> tuple[DepthSeeds, ...]:
    step = max(1, round(max(pair.left.size_wh) / _SPAN_PX))
    cameras = tuple(smaller_camera(camera, step) for camera in (pair.left, pair.right))
    shots = tuple(_smaller(photograph, step) for photograph in photographs)
    everything = [
        Foreground(
            camera=camera.name,
            coverage=np.ones(camera.shape_hw, dtype=np.float32),
            contour_level=0.5,
            everything=True,
        )
        for camera in cameras
    ]
    small = replace(pair, left=cameras[0], right=cameras[1])
    rectified = rectify(small, shots[0], shots[1], everything[0], everything[1])
    depths = _depths(rectified, centre_world)
    centre = float(rectified.left.camera_from_world.apply(centre_world[None])[0, 2])
    sides = [(depth < _NEAR * centre, depth > _FAR * centre) for depth in depths]
    plane = board(depths[0], _cleaned(sides[0][0], 0.0))
    seeds = []
    for number, (camera, ideal) in enumerate(zip(cameras, (rectified.left, rectified.right), strict=True)):
        near, far = sides[number]
        if plane is not None:
            near, lying = _parted(depths[number], near, plane if number == 0 else _of_the_right(plane, rectified))
            far = far | lying
        near, far = _cleaned(near, 0.0), _cleaned(far, _SMALLEST_FAR)
        at = _places(camera, ideal)
        one = DepthSeeds(camera=camera.name, step=step, near=_looked_up(near, at), far=_looked_up(far, at))
        if one.near.mean() < _LEAST_SHARE:
            return ()
        seeds.append(one)
    return tuple(seeds)


def _of_the_right(plane: Float64[Array, 3], rectified: RectifiedPair) -> Float64[Array, 3]:
    """The same plane in the right picture.

    u_left is u_right + focal length × base × reciprocal depth + the offset.
    """
    focal = float(rectified.left.matrix[0, 0])
    base = float(np.linalg.norm(rectified.right.centre_world - rectified.left.centre_world))
    offset = float(rectified.left.matrix[0, 2] - rectified.right.matrix[0, 2])
    moved = np.array([plane[0], plane[1], plane[2] + plane[0] * offset])
    return moved / (1 - plane[0] * focal * base)


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


def _depths(rectified: RectifiedPair, centre_world: Float64[Array, 3]) -> list[Float32[Array, "h w"]]:
    """Depth z of each pixel of both rectified pictures, mm.

    NaN where both directions do not agree.
    """
    left, right = rectified.left, rectified.right
    focal = float(left.matrix[0, 0])
    base = float(np.linalg.norm(right.centre_world - left.centre_world))
    centre = float(left.camera_from_world.apply(centre_world[None])[0, 2])
    columns = float(left.matrix[0, 2] - right.matrix[0, 2])  # the disparity of what is infinitely far
    nearest, farthest = (focal * base / (share * centre) + columns for share in (_NEAREST, _FARTHEST))
    lowest, count = int(np.floor(-nearest)), int(np.ceil(nearest - farthest)) + 2
    levels = [
        Level(image=image.copy(), mask=mask.copy())  # as the matching has them: one type for each kernel
        for image, mask in (
            (rectified.left_image, rectified.left_mask),
            (rectified.right_image, rectified.right_mask),
        )
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
    return found


def board(depth: Float32[Array, "h w"], near: Bool[Array, "h w"]) -> Float64[Array, 3] | None:
    """The plane on which the subject lies or against which it leans.

    None where it does neither. Half of what is near makes such a plane, and the rest stands before it: a body curves
    away behind whatever plane fits it best.

    Args:
        depth: z of each pixel of a rectified picture, mm; NaN where not known.
        near: what is in the working volume.

    Returns:
        a, b, c of the plane's reciprocal depth a u + b v + c, 1/mm, linear in the picture as every plane's.
    """
    rows, columns = np.nonzero(near)
    if len(rows) < _LEAST_SHARE * near.size:
        return None
    places = np.stack([columns, rows, np.ones(len(rows))], axis=1).astype(np.float64)
    inverse = 1.0 / depth[near].astype(np.float64)
    rng = np.random.default_rng(_DRAWN)
    some = rng.choice(len(rows), size=min(len(rows), _SOME), replace=False)
    best, most = np.zeros(3), -1
    for _ in range(_TRIALS):
        three = rng.choice(some, size=3, replace=False)
        if abs(np.linalg.det(places[three])) < _LEAST_AREA * near.size:
            continue
        plane = np.linalg.solve(places[three], inverse[three])
        on = int(np.count_nonzero(np.abs(places[some] @ plane - inverse[some]) < _FLATNESS * inverse[some]))
        if on > most:
            best, most = plane, on
    for _ in range(_FITS):  # three points' own errors grow towards the picture's corners
        on_it = np.abs(places @ best - inverse) < _FLATNESS * inverse
        if np.count_nonzero(on_it) >= 3:
            best = np.linalg.lstsq(places[on_it], inverse[on_it])[0]
    ahead = 1 - places @ best / inverse  # share of the depth by which it stands before the plane
    lying, standing = float(np.mean(np.abs(ahead) < _FLATNESS)), float(np.mean(ahead >= _FLATNESS))
    behind = 1 - lying - standing
    if lying < _BOARD or standing < _ON_BOARD or behind > _BELOW * standing:
        return None
    return best


def _parted(
    depth: Float32[Array, "h w"], near: Bool[Array, "h w"], plane: Float64[Array, 3]
) -> tuple[Bool[Array, "h w"], Bool[Array, "h w"]]:
    """Split near pixels at a board: in front, and on or behind."""
    rows, columns = np.indices(depth.shape)
    with np.errstate(invalid="ignore"):
        ahead = 1 - (plane[0] * columns + plane[1] * rows + plane[2]) * depth
    return near & (ahead >= _STANDING * _FLATNESS), near & (ahead < _FLATNESS)


def _cleaned(mask: Bool[Array, "h w"], least_share: float) -> Bool[Array, "h w"]:
    """Remove thin parts and specks beside the largest part, and close gaps."""
    opened = ndimage.binary_opening(ndimage.binary_closing(mask), iterations=2)
    labels, count = ndimage.label(opened)
    if count == 0:
        return opened
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    large: Bool[Array, "h w"] = (sizes >= max(_SMALLEST_PART * sizes.max(), least_share * mask.size))[labels]
    return large


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
