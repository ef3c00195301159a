"""Places where a silhouette does not bound the subject.

Something else stands in front. A rail of a posing frame cuts a body in two in a photograph, and a dark strap looks
like background. A silhouette alone would then carve away what other cameras see. Measured skin shows it: a point that
a pair has measured, and that most other cameras see on the subject too, cannot lie beside the subject in the rest.
Something hides it there. Such places are unknown and carve nothing. A point that most others see beside the subject is
no part of it: their silhouettes hold. A camera that is blocked at a place does not know what lies behind it, and has no
vote there: votes are taken anew until no camera is found blocked at further places.

Skin is measured up to half a window before what hides it. Where it faces the camera, a little more of it counts as
measured (`continued_world`): matching ends before what hides skin does, since windows near the edge see both.
Where the subject really ends, its skin turns away.

Where no pair has measured the skin, since all see the same dark band on it, the skin on both sides tells
(`spanned_mm`). What spans a slit counts like a measured point. Skin turns away from the camera where the subject really
ends: it is seen at a grazing angle there, or not measured at all. Skin that faces the camera right up to a slit, on
both sides and in line, goes on behind it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

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

_GUARD_PX = 3.0  # of `block_of`: nearer to a silhouette a datum's own error may put it beside; chosen by eye
SAMPLES = 300_000
"""Of a view's data that are looked up in others: a dozen a block that the subject fills."""
_LEAST_SHARE = 2e-4  # of the subject's blocks that a blocked place covers, at least: fewer are outliers; chosen by eye
_GAP_BLOCKS = 4  # gaps between data that are narrower than twice this belong to the place, at least; chosen by eye
_ROUNDS = 4  # of votes, at most; two are usual
_LONG = 3.5  # widths² that a bar covers at least: most rails and bands 5 to 10, hair below 3.7 (docs/decisions/0025)
_WIDENING = 1.25  # of the widest blocked place: gaps as wide as what blocks the view belong to it; chosen by eye


@value(eq=False)
class Occlusion:
    """Places where one camera's view of the subject is blocked."""

    camera: str
    blocks: Bool[Array, "H W"]
    """Squares of `step` pixels that show something before the subject."""
    step: int
    share: float
    """Of the subject in that photograph, the blocked places included."""

    def pixels(self, shape_hw: tuple[int, int]) -> Bool[Array, "h w"]:
        """The blocked pixels of the photograph."""
        whole = self.blocks.repeat(self.step, axis=0).repeat(self.step, axis=1)
        return whole[: shape_hw[0], : shape_hw[1]]


def find_occlusions(
    range_images: Sequence[RangeImage], foregrounds: Mapping[str, Foreground], rig: Rig
) -> dict[str, Occlusion]:
    """Find the places where cameras see something before the subject.

    A datum counts if, of the cameras of other pairs that have it in their picture, at least one sees it on the subject,
    and no more see it beside the subject than on it.

    Args:
        range_images: measured skin of each pair, without what is dented.
        foregrounds: silhouettes by camera; those that are not known have no say.
        rig: the calibrated cameras.

    Returns:
        Camera → where it is blocked, for the cameras that are.
    """
    views = {
        name: _View.of(foreground, rig.cameras[name])
        for name, foreground in foregrounds.items()
        if not foreground.everything and foreground.mask.any()
    }
    polls = []
    further = map_in_threads(continued_world, range_images)
    for image, past in zip(range_images, further, strict=True):
        points = image.valid_points_world()
        own = [views[name] for name in rig.pair_names[image.name] if name in views]
        others = [name for name in views if name not in rig.pair_names[image.name]]
        for seen in (points, _shown(past, own)):
            some = seen[:: max(1, len(seen) // SAMPLES)]
            places = {}
            for name, view in views.items():
                places[name], depth_mm = view.places(some)
                if seen is points:
                    at = places[name]
                    np.minimum.at(view.depth_mm, (at.row[::2], at.column[::2]), depth_mm[::2])
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
        for poll in polls:
            _vote(poll, views, blocks, hits)
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
    """Silhouettes that carve nothing where the view is blocked. The others as they are."""
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
    """One camera's silhouette in blocks, and the depths gathered there."""

    camera: Camera
    step: int
    """Pixels a block."""
    subject: Bool[Array, "H W"]
    near: Bool[Array, "H W"]
    """On the subject or so near to it that a datum's error may put it there."""
    depth_mm: Float64[Array, "H W"]
    """Of the nearest datum of any pair, along the optical axis; infinite where there is none."""

    @classmethod
    def of(cls, foreground: Foreground, camera: Camera) -> _View:
        """Nothing gathered yet."""
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
        """Points in each of the picture's places, with their depths along the optical axis, mm."""
        height, width = self.subject.shape
        column, row, depth_mm = projected(self.camera, points_world).T
        column, row = column / self.step, row / self.step
        index = np.flatnonzero((column >= 0) & (row >= 0) & (column < width) & (row < height))  # NaN is nowhere
        places = _Places(
            index=index.astype(np.int32), row=row[index].astype(np.int32), column=column[index].astype(np.int32)
        )
        return places, depth_mm[index]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Places:
    """The points that a picture holds, and their blocks.

    All pictures' together are most of what is held in memory here.
    """

    index: Int32[Array, " n"]
    row: Int32[Array, " n"]
    column: Int32[Array, " n"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Poll:
    """Points of which views decide whether they are skin."""

    count: int
    """Of points."""
    places: Mapping[str, _Places]
    """Camera → where its picture holds which of them."""
    voters: Sequence[str]
    """Cameras that have a vote, and in which such points are counted."""
    shown: Mapping[str, Bool[Array, "H W"]] | None = None
    """Camera → what shows the subject. None: each silhouette."""


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
    """Let views decide which points are skin, and mark in `hits` where those lie beside the subject.

    A camera has no vote where it is known to be blocked.
    """
    on, beside = (np.zeros(poll.count, dtype=np.int32) for _ in range(2))
    for name in poll.voters:
        at = poll.places[name]
        sees = (views[name].near if poll.shown is None else poll.shown[name])[at.row, at.column]
        on[at.index[sees]] += 1
        beside[at.index[~sees & ~blocked[name][at.row, at.column]]] += 1
    agreed = (on > 0) & (beside <= on)
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
    # A bar is about as wide where nobody has measured the skin behind it.
    radius = max(_GAP_BLOCKS, _WIDENING * float(_depths(large).max()))
    closed = _closed(large | subject, radius)
    around = ndimage.distance_transform_edt(~large) <= 2 * radius
    joined: Bool[Array, "H W"] = (closed & around & ~subject) | large
    # With the subject on both sides, a bar goes on to where it leaves the subject. Hair is as wide as it is long.
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
    """A place with gaps closed that are narrower than twice the radius, blocks."""
    pad = int(radius) + 2
    near = ndimage.distance_transform_edt(~np.pad(place, pad, mode="edge")) <= radius
    return np.asarray((ndimage.distance_transform_edt(near) > radius)[pad:-pad, pad:-pad])


def _depths(place: Bool[Array, "H W"]) -> Float64[Array, "H W"]:
    """Distance of each block from the place's edge, blocks: half of its width where that is greatest."""
    return np.asarray(ndimage.distance_transform_edt(np.pad(place, 1))[1:-1, 1:-1])


_WIDEST_MM = 90.0  # between both sides of a slit: a band or a rail has 15 to 50 mm; chosen by eye
_SIDE_MM = 12.0  # of skin on each side, from which its direction and bend are taken; chosen by eye
_LEAST_BLOCKS = 4  # of measured skin on each side
_EDGE_BLOCKS = 4  # from the slit to the nearest measured skin, at most: windows end before an edge; chosen by eye
_STEEPEST = np.tan(np.radians(60.0))  # of skin that faces the camera: at an occluding edge it is steeper; chosen by eye
_SQUARE = np.cos(np.radians(50.0))  # a line crosses a slit's edges: others are chords of a bent outline; chosen by eye
_OUTLINE_BLOCKS = 2.0  # Gaussian by which an outline's direction is taken; chosen by eye
_BEND = 0.5  # of the slit's width: how far apart in depth both sides' continuations may meet; chosen by eye


def spanned_mm(
    camera: Camera, subject: Bool[Array, "H W"], step: int, depth_mm: Float64[Array, "H W"]
) -> Float64[Array, "H W"]:
    """Depth of what spans the slits in a silhouette, infinite elsewhere.

    Along the optical axis. Rows and columns are scanned. Where both cross a slit, the shorter way counts.

    Args:
        camera: whose silhouette it is.
        subject: blocks of `step` pixels on the subject.
        step: pixels a block.
        depth_mm: measured depth along the optical axis of each block, infinite where none is measured.
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
    whole = ndimage.binary_opening(np.isfinite(spans), np.ones((3, 3), dtype=bool))  # one line alone is an outlier
    spans[~whole] = np.inf
    return spans


def points_world(camera: Camera, step: int, depth_mm: Float64[Array, "H W"]) -> Float64[Array, "n 3"]:
    """Points of the blocks that have a depth, mm."""
    row, column = np.nonzero(np.isfinite(depth_mm))
    xy = camera.normalised_from_pixels(np.stack([column, row], axis=1) * float(step))
    points = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * depth_mm[row, column, None]
    return camera.camera_from_world.inverse().apply(points)


def _bridged(
    subject: Bool[Array, " w"], depth_mm: Float64[Array, " w"], crossed: Bool[Array, " w"], block_per_mm: float
) -> Iterator[tuple[slice, Float64[Array, " k"]]]:
    """Yield the slits of one line, and the depth of what spans each, block by block."""
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
        # The cubic that continues both sides (Hermite's), in inverse depth, where planes are straight.
        t = np.arange(1, blocks) / blocks
        inverse = (
            near.inverse * (1 + 2 * t) * (1 - t) ** 2
            + far.inverse * (3 - 2 * t) * t**2
            + blocks * t * (1 - t) * (near.slope * (1 - t) + far.slope * t)
        )
        yield slice(before + 1, after), 1 / inverse


@dataclass(frozen=True, slots=True)
class _Side:
    """Skin beside a slit."""

    inverse: float
    """Inverse depth at the edge, 1/mm."""
    slope: float
    """Its change per block from the edge into the slit: constant on a plane."""


def _side(outward_mm: Float64[Array, " k"], block_per_mm: float) -> _Side | None:
    """Skin from a slit's edge outward. None unless it is measured up to the edge and faces the camera."""
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


_NEIGHBOURHOOD_MM = 6.0  # half-width of the window that gives the skin's direction; chosen by eye
_TURNED_MM = 0.5  # by which data lie behind the tangent plane where skin turns away; chosen by eye


def continued_world(image: RangeImage) -> Float64[Array, "n 3"]:
    """Continue a pair's data past their edges.

    Points on their tangent planes, world frame, mm. Only of skin that faces the camera and does not turn away. Data
    nearer to an edge than half a window say no more than that.
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
    near = np.hypot(row - own_row, column - own_column) <= 2 * EDGE_PX * unit  # as far past the edge
    near &= cosines[row, column] >= LEAST_COSINE  # never where there is no normal
    own_row, own_column, row, column = (indices[near] for indices in (own_row, own_column, row, column))
    # Not `image.ray_directions`: of a whole picture they take 90 MB.
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
    kept = (steep >= LEAST_COSINE / 2) & ~turned[row, column]  # a plane seen so obliquely runs off
    points: Float64[Array, "n 3"] = image.camera.centre_world + ray[kept] * range_mm[kept, None]
    return points
