"""Places where a silhouette does not bound the subject, because something is in front of it.

In a photograph a rail of a posing frame cuts a body in two, and a dark strap looks like background. The silhouette
alone would then remove what other cameras see. Measured skin shows such places: a point that a pair has measured and
most other cameras see on the subject cannot be outside the subject in the remaining ones, so something hides it there.
These places are unknown and remove nothing. A point that most others see outside the subject is not part of it: their
silhouettes are used. A camera has no vote where its view is blocked; votes are repeated until no camera is blocked at
further places.

Matching ends up to half a window before an occluding edge, since windows near it see both sides. So skin that faces the
camera is continued a little (`continued_world`). Where the subject really ends, its skin turns away.

If no pair has measured the skin, since all see the same dark band on it, the skin on both sides decides
(`spanned_mm`). At a real end of the subject, skin is seen at a grazing angle or not measured at all. Skin that faces
the camera up to both edges of a slit, and is in line, continues behind it. Spans count like measured points.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import ndimage

from mammometry.base.machine.cores import map_in_threads
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float64, Int32, Rig
from mammometry.geometry.projection import projected
from mammometry.matching.foreground.foreground import Foreground, block_of
from mammometry.surface.ranges import image_kernels
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.surface.ranges.strands import EDGE_PX
from mammometry.surface.ranges.visibility import LEAST_COSINE

_GUARD_PX = 3.0  # px of `block_of`: within it a datum's own error may put it outside a silhouette; not critical
SAMPLES = 300_000
"""Largest number of a view's data that are looked up in other views: about a dozen per block of the subject."""
_MOST_SAMPLES = 8 * SAMPLES  # for all pairs together: the pairs of a walk see the same skin; limits memory and time
_LEAST_SHARE = 2e-4  # smallest place, relative to the subject's blocks: fewer are outliers; not critical
_GAP_BLOCKS = 4  # gaps between data narrower than twice this belong to the place; not critical
_ROUNDS = 4  # most rounds of votes; two are usual
_LONG = 3.5  # least area of a bar in widths²: most rails and bands have 5 to 10, hair below 3.7 (docs/decisions/0025)
_WIDENING = 1.25  # gaps up to this times the width of the widest place belong to it; not critical


@value(eq=False)
class Occlusion:
    """Places where something hides the subject from one camera."""

    camera: str
    blocks: Bool[Array, "H W"]
    """Squares of `step` pixels in which something is in front of the subject."""
    step: int
    share: float
    """Hidden share of the subject in that photograph."""

    def pixels(self, shape_hw: tuple[int, int]) -> Bool[Array, "h w"]:
        """Mask of the hidden pixels of the photograph."""
        whole = self.blocks.repeat(self.step, axis=0).repeat(self.step, axis=1)
        return whole[: shape_hw[0], : shape_hw[1]]


def find_occlusions(
    range_images: Sequence[RangeImage], foregrounds: Mapping[str, Foreground], rig: Rig
) -> dict[str, Occlusion]:
    """Find the places where something hides the subject from a camera.

    A datum counts as skin if at least one camera of another pair sees it on the subject, and at least as many see it on
    the subject as outside.

    Args:
        range_images: measured skin of each pair, without dents.
        foregrounds: silhouettes by camera. Unknown ones are ignored.
        rig: the calibrated cameras.

    Returns:
        Camera → its hidden places. Cameras without such places are left out.
    """
    views = {
        name: _View.of(foreground, rig.cameras[name])
        for name, foreground in foregrounds.items()
        if not foreground.everything and foreground.mask.any()
    }
    polls = []
    further = map_in_threads(continued_world, range_images)
    most = min(SAMPLES, _MOST_SAMPLES // max(1, len(range_images)))
    for image, past in zip(range_images, further, strict=True):
        points = image.valid_points_world()
        own = [views[name] for name in rig.pair_names[image.name] if name in views]
        others = [name for name in views if name not in rig.pair_names[image.name]]
        for seen in (points, _shown(past, own)):
            some = seen[:: max(1, len(seen) // most)]
            look_up = partial(_View.measured if seen is points else _View.places, points_world=some)
            looked_up = map_in_threads(look_up, list(views.values()))
            places = {name: at for name, (at, _) in zip(views, looked_up, strict=True)}
            polls.append(_Poll(count=len(some), places=places, voters=others))
    spans = {name: spanned_mm(view.camera, view.subject, view.step, view.depth_mm) for name, view in views.items()}
    shown = {name: view.near | np.isfinite(spans[name]) for name, view in views.items()}
    for name, view in views.items():
        points = points_world(view.camera, view.step, spans[name])
        places = {name: view.places(points)[0] for name, view in views.items()}
        polls.append(_Poll(count=len(points), places=places, voters=list(views), shown=shown))
    blocks = {name: np.zeros_like(view.subject) for name, view in views.items()}
    for _ in range(_ROUNDS):
        hits = {name: np.zeros_like(view.subject) for name, view in views.items()}
        map_in_threads(partial(_vote, views=views, blocked=blocks, hits=hits), polls)
        before, blocks = blocks, {name: _joined(hits[name], view.subject) for name, view in views.items()}
        if all(np.array_equal(blocks[name], before[name]) for name in views):
            break
    found = {}
    for name, view in views.items():
        if blocks[name].any():
            count = np.count_nonzero(blocks[name])
            share = count / (count + np.count_nonzero(view.subject))
            found[name] = Occlusion(camera=name, blocks=blocks[name], step=view.step, share=float(share))
    return found


def without_occluded(foregrounds: Mapping[str, Foreground], blocked: Mapping[str, Occlusion]) -> dict[str, Foreground]:
    """The silhouettes without their edges at hidden places."""
    opened = {}
    for name, foreground in foregrounds.items():
        if name in blocked:
            pixels = blocked[name].pixels(foreground.coverage.shape)
            coverage = np.where(pixels, np.float32(1.0), foreground.coverage)
            opened[name] = replace(foreground, coverage=coverage)
        else:
            opened[name] = foreground
    return opened


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _View:
    """One camera's silhouette in blocks, and the depths measured there."""

    camera: Camera
    step: int
    """Pixels per block."""
    subject: Bool[Array, "H W"]
    near: Bool[Array, "H W"]
    """On the subject, or so close to it that a datum's error may put it there."""
    depth_mm: Float64[Array, "H W"]
    """Depth of the nearest datum of any pair along the optical axis. Infinite without a datum."""

    @classmethod
    def of(cls, foreground: Foreground, camera: Camera) -> _View:
        """A view without measured depths."""
        step, unit = block_of(foreground.coverage.shape)
        subject = foreground.mask[::step, ::step]
        outside_px = ndimage.distance_transform_edt(~subject) * (step / unit)
        return cls(
            camera=camera,
            step=step,
            subject=subject,
            near=outside_px <= _GUARD_PX,
            depth_mm=np.full(subject.shape, np.inf),
        )

    def places(self, points_world: Float64[Array, "n 3"]) -> tuple[_Places, Float64[Array, " k"]]:
        """Blocks of the points that are in the image, and their depths along the optical axis, mm."""
        height, width = self.subject.shape
        column, row, depth_mm = projected(self.camera, points_world).T
        column, row = column / self.step, row / self.step
        index = np.flatnonzero((column >= 0) & (row >= 0) & (column < width) & (row < height))  # false for NaN
        places = _Places(
            index=index.astype(np.int32), row=row[index].astype(np.int32), column=column[index].astype(np.int32)
        )
        return places, depth_mm[index]

    def measured(self, points_world: Float64[Array, "n 3"]) -> tuple[_Places, Float64[Array, " k"]]:
        """As `places`. The depths of every second point are also entered in `depth_mm`."""
        at, depth_mm = self.places(points_world)
        np.minimum.at(self.depth_mm, (at.row[::2], at.column[::2]), depth_mm[::2])
        return at, depth_mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Places:
    """Points in an image and their blocks. Those of all images take most of the memory of this module."""

    index: Int32[Array, " n"]
    row: Int32[Array, " n"]
    column: Int32[Array, " n"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Poll:
    """Points about which views vote whether they are skin."""

    count: int
    """Number of points."""
    places: Mapping[str, _Places]
    """Camera → the points in its image, and their blocks."""
    voters: Sequence[str]
    """Cameras that vote, and in which hidden points are counted."""
    shown: Mapping[str, Bool[Array, "H W"]] | None = None
    """Camera → blocks that count as the subject. None: its silhouette."""


def _shown(points_world: Float64[Array, "n 3"], views: Sequence[_View]) -> Float64[Array, "m 3"]:
    """Points that all these views see on the subject."""
    shown = np.ones(len(points_world), dtype=bool)
    for view in views:
        at, _ = view.places(points_world)
        on = np.zeros(len(points_world), dtype=bool)
        on[at.index] = view.subject[at.row, at.column]
        shown &= on
    return points_world[shown]


def _vote(
    poll: _Poll,
    views: Mapping[str, _View],
    blocked: Mapping[str, Bool[Array, "H W"]],
    hits: Mapping[str, Bool[Array, "H W"]],
) -> None:
    """Let views vote which points are skin, and mark in `hits` where such points are outside the subject.

    The vote of a camera against a point is ignored where its view is known to be blocked.
    """
    on, outside = (np.zeros(poll.count, dtype=np.int32) for _ in range(2))
    for name in poll.voters:
        at = poll.places[name]
        sees = (views[name].near if poll.shown is None else poll.shown[name])[at.row, at.column]
        on[at.index[sees]] += 1
        outside[at.index[~sees & ~blocked[name][at.row, at.column]]] += 1
    agreed = (on > 0) & (outside <= on)
    for name in poll.voters:
        at = poll.places[name]
        hit = agreed[at.index] & ~views[name].near[at.row, at.column]
        hits[name][at.row[hit], at.column[hit]] = True


def _joined(hit: Bool[Array, "H W"], subject: Bool[Array, "H W"]) -> Bool[Array, "H W"]:
    """Hit places without outliers, with gaps closed up to the subject."""
    labels, _ = ndimage.label(hit, structure=np.ones((3, 3)))
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    large = (sizes >= max(_LEAST_SHARE * np.count_nonzero(subject), 2))[labels]
    if not large.any():
        return large
    # Where the skin behind a bar was not measured, assume that it is about as wide.
    radius = max(_GAP_BLOCKS, _WIDENING * float(_depths(large).max()))
    closed = _closed(large | subject, radius)
    around = ndimage.distance_transform_edt(~large) <= 2 * radius
    joined: Bool[Array, "H W"] = (closed & around & ~subject) | large
    # A bar with the subject on both sides continues to where it leaves the subject. Hair is as wide as it is long.
    labels, count = ndimage.label(joined, structure=np.ones((3, 3)))
    half_widths = ndimage.maximum(_depths(joined), labels, np.arange(count + 1))
    bars = np.bincount(labels.ravel()) >= _LONG * (2 * half_widths) ** 2
    bars[0] = False
    if not bars.any():
        return joined
    half_width = float(half_widths[bars].max())
    onwards = _closed(joined | subject, _WIDENING * half_width) & ~subject & ~joined
    ahead, count = ndimage.label(onwards)
    ends = np.bincount(ahead[ndimage.binary_dilation(bars[labels])], minlength=count + 1)
    return np.asarray(joined | ((ends >= half_width)[ahead] & onwards))


def _closed(place: Bool[Array, "H W"], radius: float) -> Bool[Array, "H W"]:
    """The place with gaps narrower than twice the radius (blocks) closed."""
    pad = int(radius) + 2
    near = ndimage.distance_transform_edt(~np.pad(place, pad, mode="edge")) <= radius
    return np.asarray((ndimage.distance_transform_edt(near) > radius)[pad:-pad, pad:-pad])


def _depths(place: Bool[Array, "H W"]) -> Float64[Array, "H W"]:
    """Distance of each block from the place's edge, blocks. At its largest it is half the place's width."""
    return np.asarray(ndimage.distance_transform_edt(np.pad(place, 1))[1:-1, 1:-1])


_WIDEST_MM = 90.0  # between both sides of a slit: a band or a rail has 15 to 50 mm; not critical
_SIDE_MM = 12.0  # width of the skin on each side from which its slope and curvature are measured; not critical
_LEAST_BLOCKS = 4  # fewest blocks of measured skin on each side
_EDGE_BLOCKS = 4  # largest distance from the slit to measured skin: windows end before an edge; not critical
_STEEPEST = np.tan(np.radians(60.0))  # largest slope of skin at a slit: at the subject's end it is larger; not critical
_SQUARE = np.cos(np.radians(50.0))  # least cosine of a line to both edges' normals: others are chords; not critical
_OUTLINE_BLOCKS = 2.0  # Gaussian σ with which an outline's direction is measured; not critical
_BEND = 0.5  # largest difference in depth between both sides' continuations, in slit widths; not critical


def spanned_mm(
    camera: Camera, subject: Bool[Array, "H W"], step: int, depth_mm: Float64[Array, "H W"]
) -> Float64[Array, "H W"]:
    """Depth along the optical axis of spans across the slits in a silhouette. Infinite elsewhere.

    Rows and columns are scanned. If both cross a slit, the shorter one counts.

    Args:
        camera: camera of the silhouette.
        subject: blocks of `step` pixels on the subject.
        step: pixels per block.
        depth_mm: measured depth along the optical axis of each block. Infinite if not measured.
    """
    spans = np.full(subject.shape, np.inf)
    widths = np.full(subject.shape, np.inf)
    measured = np.where(subject, depth_mm, np.inf)
    even = ndimage.gaussian_filter(subject.astype(np.float64), _OUTLINE_BLOCKS)
    down, along = np.gradient(even)
    slopes = np.stack([along, down])
    square = np.abs(slopes) >= _SQUARE * np.linalg.norm(slopes, axis=0)
    for axis in (0, 1):  # lines along rows, then along columns
        lines = [array if axis == 0 else array.T for array in (subject, measured, square[axis], spans, widths)]
        for on, depth, crossed, span, width in zip(*lines, strict=True):
            for slit, across_mm in _bridged(on, depth, crossed, step / camera.intrinsics[axis]):
                shorter = len(across_mm) < width[slit]
                span[slit][shorter] = across_mm[shorter]
                width[slit][shorter] = len(across_mm)
    whole = ndimage.binary_opening(np.isfinite(spans), np.ones((3, 3), dtype=bool))  # a single line is an outlier
    spans[~whole] = np.inf
    return spans


def points_world(camera: Camera, step: int, depth_mm: Float64[Array, "H W"]) -> Float64[Array, "n 3"]:
    """World points of the blocks with a depth, mm."""
    row, column = np.nonzero(np.isfinite(depth_mm))
    xy = camera.normalised_from_pixels(np.stack([column, row], axis=1) * float(step))
    points = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * depth_mm[row, column, None]
    return camera.camera_from_world.inverse().apply(points)


def _bridged(
    subject: Bool[Array, " w"], depth_mm: Float64[Array, " w"], crossed: Bool[Array, " w"], block_per_mm: float
) -> Iterator[tuple[slice, Float64[Array, " k"]]]:
    """Yield the slits of one line, and the depth of each block of their spans."""
    edges = np.flatnonzero(np.diff(subject.astype(np.int8)))
    for before, after in zip(edges[:-1], edges[1:] + 1, strict=True):
        if not (subject[before] and crossed[before] and crossed[after]):  # a run of subject, or a chord
            continue
        near, far = _side(depth_mm[before::-1], block_per_mm), _side(depth_mm[after:], block_per_mm)
        if near is None or far is None:
            continue
        blocks = after - before
        mean_mm = 2 / (near.inverse + far.inverse)
        width_mm = np.hypot(blocks * block_per_mm * mean_mm, 1 / near.inverse - 1 / far.inverse)
        ahead, back = (side.inverse + side.slope * blocks / 2 for side in (near, far))
        if width_mm > _WIDEST_MM or min(ahead, back) <= 0 or abs(1 / ahead - 1 / back) > _BEND * width_mm:
            continue
        # Hermite's cubic continues both sides. In inverse depth, planes are straight.
        t = np.arange(1, blocks) / blocks
        inverse = (
            near.inverse * (1 + 2 * t) * (1 - t) ** 2
            + far.inverse * (3 - 2 * t) * t**2
            + blocks * t * (1 - t) * (near.slope * (1 - t) + far.slope * t)
        )
        yield slice(before + 1, after), 1 / inverse


@dataclass(frozen=True, slots=True)
class _Side:
    """Skin at one side of a slit."""

    inverse: float
    """Inverse depth at the edge, 1/mm."""
    slope: float
    """Change of the inverse depth per block, from the edge into the slit. Constant on a plane."""


def _side(outward_mm: Float64[Array, " k"], block_per_mm: float) -> _Side | None:
    """Skin from a slit's edge outwards. None unless it is measured up to the edge and faces the camera."""
    known = np.isfinite(outward_mm[:_EDGE_BLOCKS])
    if not known.any():
        return None
    reach = max(2 * _LEAST_BLOCKS, int(_SIDE_MM / (block_per_mm * outward_mm[np.argmax(known)])))
    at = np.flatnonzero(np.isfinite(outward_mm[:reach]))
    if len(at) < _LEAST_BLOCKS:
        return None
    _, slope, inverse = np.polyfit(at, 1 / outward_mm[at], 2)
    # dz/dx: over a block, z changes by −(1/z)' z², and x by block_per_mm · z.
    if abs(slope) > _STEEPEST * block_per_mm * inverse:
        return None
    return _Side(float(inverse), float(-slope))


_NEIGHBOURHOOD_MM = 6.0  # half-width of the window for the skin's normal; not critical
_TURNED_MM = 0.5  # distance of data behind the tangent plane from which skin turns away; not critical


def continued_world(image: RangeImage) -> Float64[Array, "n 3"]:
    """Points beyond the edges of a pair's data, on tangent planes of the nearest data, world frame, mm.

    Only skin that faces the camera and does not turn away is continued. Data within half a window of an edge, which are
    biased, are replaced too.
    """
    unit = block_of(image.valid.shape)[1]
    if image.valid.all():  # no datum has an edge
        return np.empty((0, 3))
    sound = image_kernels.distance_px(~image.valid) > EDGE_PX * unit
    if not sound.any():
        return np.empty((0, 3))
    normals = image.keeping(sound).normals_camera(_NEIGHBOURHOOD_MM)
    cosines = image_kernels.incidence_cosines(normals, image.camera.intrinsics)
    rows, columns = image_kernels.nearest_true(sound)
    own_row, own_column = np.nonzero(~sound)
    row, column = rows[own_row, own_column], columns[own_row, own_column]
    near = np.hypot(row - own_row, column - own_column) <= 2 * EDGE_PX * unit  # as far beyond the edge as inside it
    near &= cosines[row, column] >= LEAST_COSINE  # false without a normal
    own_row, own_column, row, column = (indices[near] for indices in (own_row, own_column, row, column))
    # `image.ray_directions` would need 90 MB for a full image.
    datum, ray = (
        image.camera.rays_world(np.stack(at, axis=-1).astype(np.float64))
        for at in ((column, row), (own_column, own_row))
    )
    there = datum * image.range_mm[row, column][:, None]
    normal = normals[row, column] @ image.camera.camera_from_world.rotation
    steep = -np.einsum("ni,ni->n", normal, ray)
    range_mm = -np.einsum("ni,ni->n", normal, there) / np.maximum(steep, LEAST_COSINE / 2)
    behind = image.valid[own_row, own_column] & (image.range_mm[own_row, own_column] > range_mm + _TURNED_MM)
    turned = np.zeros(image.valid.shape, dtype=bool)
    turned[row[behind], column[behind]] = True
    kept = (steep >= LEAST_COSINE / 2) & ~turned[row, column]  # a plane seen more obliquely runs far off
    points: Float64[Array, "n 3"] = image.camera.centre_world + ray[kept] * range_mm[kept, None]
    return points
