"""Removal of range data that are not the subject's skin: dents (paper 2.6.2) and detached pieces.

Dents are smeared depth discontinuities, seen at grazing angles. Data far behind the subject's centre are background,
if no silhouette excluded them. Of the connected pieces of all pairs' data, the largest is the subject; detached smaller
ones are removed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from scipy import ndimage

from mammometry.base.errors import SurfaceError
from mammometry.base.machine.cores import map_in_threads
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64, UInt8, to_step
from mammometry.geometry.projection import projected
from mammometry.surface.ranges.range_image import SIGMAS, RangeImage
from mammometry.surface.ranges.visibility import Label, compare, gap_mm
from mammometry.surface.settings import DecomposeSettings, DentSettings


@value(eq=False)
class Patches:
    """Each range image labelled against each other one."""

    labels: Mapping[tuple[str, str], UInt8[Array, "h w"]]
    """(A, B) → label of each element of A against B (`visibility.Label`). OUTSIDE where A has no datum."""
    patches: Mapping[tuple[str, str], Int32[Array, "h w"]]
    """(A, B) → patch of each element of A, from 1: connected elements of one label. 0 without datum."""


def decompose(range_images: Sequence[RangeImage], settings: DecomposeSettings = DecomposeSettings()) -> Patches:
    """Label all range images against each other, and group equal neighbours into patches (paper 2.6.1).

    Neighbours share a side. Elements that another view does not see (OUTSIDE) form patches too.
    """
    labels: dict[tuple[str, str], UInt8[Array, "h w"]] = {}
    patches: dict[tuple[str, str], Int32[Array, "h w"]] = {}
    for image in range_images:
        points = image.valid_points_world()
        for other in range_images:
            if other is image:
                continue
            label = np.full(image.valid.shape, Label.OUTSIDE, dtype=np.uint8)
            label[image.valid] = compare(points, other, settings.epsilon_mm)
            labels[image.name, other.name] = label
            patches[image.name, other.name] = _components(label, image.valid)
    return Patches(labels=labels, patches=patches)


def _components(labels: UInt8[Array, "h w"], valid: Bool[Array, "h w"]) -> Int32[Array, "h w"]:
    """Number the 4-connected regions of equal label from 1. Only valid elements count."""
    numbers = np.zeros(labels.shape, dtype=np.int32)
    count = 0
    for label in Label:
        regions, n = ndimage.label(valid & (labels == label))
        numbers[regions > 0] = regions[regions > 0] + count
        count += n
    return numbers


_VOTES = 2
"""Views that must agree with a datum for each one that sees through it: with the datum's own, a majority of three to
one. A single other view may share its smeared discontinuity."""
SEEN_THROUGH_MM = 1.0
"""Distance in front of another view's surface from which a datum is removed, mm, if above `SIGMAS` of both."""
_MIN_PATCH = 3  # points that determine a normal
_SMALLEST_ISLAND = 30  # fewest connected data: smaller groups are remains of smeared edges; not critical
_COMMON_MM = 3.0  # data of two views closer than this count as common, for the figure's choice of a view
_ANGLE_STEP_RAD = 2.0**-6  # step of the stored angles, about 1°: they are only displayed


@value(eq=False)
class ValidPatches:
    """The remaining range data of each view."""

    range_images: tuple[RangeImage, ...]
    """Same views in the same order, with reduced `valid`."""
    angles_rad: tuple[Float32[Array, "h w"], ...]
    """Per view and element, angle between local normal and direction to the camera, rad. NaN if unknown. Steps of 2^-6.
    """


@value(eq=False)
class KeepMasks:
    """Masks of the remaining range data. With the range images they give `ValidPatches`."""

    keep: tuple[Bool[Array, "h w"], ...]
    """Per view and element, whether its datum remains."""
    angles_rad: tuple[Float32[Array, "h w"], ...]
    """As in `ValidPatches`."""

    def without(self, masks: Sequence[Bool[Array, "h w"]]) -> KeepMasks:
        """The masks without other masks, one per view."""
        keep = tuple(keep & ~mask for keep, mask in zip(self.keep, masks, strict=True))
        return KeepMasks(keep=keep, angles_rad=self.angles_rad)

    def of(self, range_images: Sequence[RangeImage]) -> ValidPatches:
        """The remaining data of the views."""
        images = tuple(image.keeping(keep) for image, keep in zip(range_images, self.keep, strict=True))
        return ValidPatches(range_images=images, angles_rad=self.angles_rad)


def remove_dents(
    range_images: Sequence[RangeImage], patches: Patches | None, settings: DentSettings = DentSettings()
) -> ValidPatches:
    """Remove range data at grazing angles, or through which another view sees.

    Rule ``patch`` is the paper's (2.6.2): each patch of the decomposition, judged by the normal at its centre. Rule
    ``element`` judges each datum by its own neighbourhood, since a large patch is not flat (METHOD 6.2), and needs no
    patches.

    Raises:
        ValueError: rule ``patch`` without patches.
        SurfaceError: no datum remains in any view.
    """
    angles = tuple(map_in_threads(lambda image: image.incidence_rad(settings.neighbourhood_mm), range_images))
    limit = np.radians(settings.angle_deg)
    if settings.rule == "none":
        kept = [image.valid.copy() for image in range_images]
    elif settings.rule == "patch":
        if patches is None:
            raise ValueError("the rule by patch needs the decomposition")
        kept = [_flat_patches(image, patches, settings.neighbourhood_mm, limit) for image in range_images]
    else:
        with np.errstate(invalid="ignore"):
            kept = [image.valid & (angle <= limit) for image, angle in zip(range_images, angles, strict=True)]
        if settings.drop_seen_through:
            facing = [image.keeping(keep) for image, keep in zip(range_images, kept, strict=True)]
            judged = map_in_threads(lambda k: _seen_through(k, facing, angles), range(len(kept)))
            kept = [keep & ~through for keep, (through, _) in zip(kept, judged, strict=True)]
            for _, outvoted in judged:
                for k, (rows, columns) in outvoted.items():
                    kept[k][rows, columns] = False
        kept = map_in_threads(_without_islands, kept)
    if not any(keep.any() for keep in kept):
        counts = ", ".join(f"{image.name} had {int(image.valid.sum())} data" for image in range_images)
        raise SurfaceError(
            "range images",
            found=f"none that faces its camera within {settings.angle_deg:g}° ({counts})",
            expected="range data of the subject in at least one pair",
            remedy="Check the disparity previews: the subject may be out of the working volume or without texture",
        )
    return ValidPatches(
        range_images=tuple(image.keeping(keep) for image, keep in zip(range_images, kept, strict=True)),
        angles_rad=tuple(to_step(angle, _ANGLE_STEP_RAD) for angle in angles),
    )


@value(eq=False)
class DentGrid:
    """One view, decomposed with several thresholds (Fig. 5)."""

    name: str
    """Pair whose range image is decomposed."""
    against: str
    """Pair against which its elements are labelled."""
    angles_deg: tuple[float, ...]
    """Thresholds of the patches' angles, degrees, one per row."""
    epsilons_mm: tuple[float, ...]
    """Half-widths of the overlapping zone, mm, one per column."""
    labels: UInt8[Array, "e h w"]
    """Per ε: `visibility.Label` of each element. OUTSIDE also where there is no datum."""
    valid: Bool[Array, "h w"]
    """Elements with a datum."""
    kept: Bool[Array, "a e h w"]
    """Per threshold and ε: data that remain."""


def dent_grid(
    range_images: Sequence[RangeImage],
    *,
    name: str | None = None,
    against: str | None = None,
    angles_deg: Sequence[float] = (40.0, 50.0, 60.0, 70.0),
    epsilons_mm: Sequence[float] = (0.0, 0.1, 1.0, 1.5),
    neighbourhood_mm: float = 5.0,
) -> DentGrid:
    """Decompose one view with several ε, and remove dents at several angles (paper 2.6.1–2, Fig. 5).

    The paper's rule, patch by patch (Eq. 2–3), compared with one other view. Default of `name` is the first view, of
    `against` the view with most data in common with it.

    Raises:
        SurfaceError: fewer than two views, or an unknown name.
    """
    views = {image.name: image for image in range_images}
    unknown = [wanted for wanted in (name, against) if wanted is not None and wanted not in views]
    if len(views) < 2 or unknown or (name is not None and name == against):
        raise SurfaceError(
            "decomposition",
            found=f"pairs {', '.join(views) or 'none'}" + (f", but not {', '.join(unknown)}" if unknown else ""),
            expected="two different pairs with range images",
            remedy="Name two pairs of this session",
        )
    image = views[name] if name else next(view for view in range_images if view.name != against)
    others = [views[against]] if against else [view for view in range_images if view is not image]
    points = image.valid_points_world()
    other = max(others, key=lambda view: int((np.abs(gap_mm(points, view)) < _COMMON_MM).sum()))
    labels, kept = [], []
    for epsilon_mm in epsilons_mm:
        patches = decompose([image, other], DecomposeSettings(epsilon_mm=epsilon_mm))
        labels.append(patches.labels[image.name, other.name])
        angle_rad = _patch_angles_rad(image, patches.patches[image.name, other.name], neighbourhood_mm)
        kept.append([image.valid & ~(angle_rad > np.radians(limit)) for limit in angles_deg])
    return DentGrid(
        name=image.name,
        against=other.name,
        angles_deg=tuple(angles_deg),
        epsilons_mm=tuple(epsilons_mm),
        labels=np.array(labels),
        valid=image.valid,
        kept=np.array(kept).swapaxes(0, 1),
    )


def patch_angle_rad(
    points_world: Float64[Array, "n 3"], centre_camera: Float64[Array, 3], neighbourhood_mm: float
) -> float:
    """Angle between a patch's normal at its centre and the direction to the camera, rad.

    Eq. 2–3: P_c is the mean of the patch (Eq. 2), C the covariance about P_c of its points within `neighbourhood_mm`
    (Eq. 3). The normal is the eigenvector of C with the smallest eigenvalue. NaN with fewer than three such points, for
    example if the patch is a ring: then it has no normal.
    """
    centre = points_world.mean(axis=0)
    offsets = points_world - centre
    near = offsets[np.einsum("ij,ij->i", offsets, offsets) <= neighbourhood_mm**2]
    if len(near) < _MIN_PATCH:
        return float("nan")
    normal = np.linalg.eigh(near.T @ near / len(near))[1][:, 0]
    towards = centre_camera - centre
    return float(np.arccos(np.clip(abs(normal @ towards) / np.linalg.norm(towards), 0.0, 1.0)))


def _flat_patches(image: RangeImage, patches: Patches, neighbourhood_mm: float, limit_rad: float) -> Bool[Array, "h w"]:
    """Elements that are in no steep patch of any comparison, nor in one of fewer than three elements."""
    keep = image.valid.copy()
    for (name, _), numbers in patches.patches.items():
        if name == image.name:
            keep &= ~(_patch_angles_rad(image, numbers, neighbourhood_mm) > limit_rad)
    return keep


def _patch_angles_rad(
    image: RangeImage, numbers: Int32[Array, "h w"], neighbourhood_mm: float
) -> Float64[Array, "h w"]:
    """Angle of each element's patch, rad.

    Infinite for patches of fewer than three elements. NaN without datum, and for a large patch without a normal (its
    centre is in its own hole), which the rule keeps.
    """
    points = image.points_world()
    angles = [float("nan")]
    for number, window in enumerate(ndimage.find_objects(numbers), start=1):
        members = points[window][numbers[window] == number]
        few = len(members) < _MIN_PATCH
        angles.append(np.inf if few else patch_angle_rad(members, image.camera.centre_world, neighbourhood_mm))
    return np.array(angles)[numbers]


def _seen_through(
    index: int, images: Sequence[RangeImage], angles: Sequence[Float32[Array, "h w"]]
) -> tuple[Bool[Array, "h w"], dict[int, tuple[Int64[Array, " n"], Int64[Array, " n"]]]]:
    """Elements of view `index` that another view sees through at a better angle, and outvoted elements.

    A datum is upheld if at least `_VOTES` other views agree with it for each one that sees through it. Then it stays,
    and the data behind it are outvoted: number of the view → rows and columns.
    """
    image = images[index]
    points = image.valid_points_world()
    own_sigma = image.sigma_mm[image.valid]
    own_angle = angles[index][image.valid]
    through = np.zeros(len(points), dtype=bool)
    agree, against = np.zeros(len(points), dtype=np.int32), np.zeros(len(points), dtype=np.int32)
    behind: dict[int, tuple[Int64[Array, " n"], Int64[Array, "n 2"]]] = {}
    for k, (other, other_angle) in enumerate(zip(images, angles, strict=True)):
        if other is image:
            continue
        gap = gap_mm(points, other)
        known = np.flatnonzero(np.isfinite(gap))
        uv = np.rint(projected(other.camera, points[known])[:, :2]).astype(np.int64)
        sigma, angle = other.sigma_mm[uv[:, 1], uv[:, 0]], other_angle[uv[:, 1], uv[:, 0]]
        tolerance = np.maximum(SEEN_THROUGH_MM, SIGMAS * np.hypot(own_sigma[known], sigma))
        # Along a grazing ray a gap exaggerates the distance between the surfaces: measure it across the surface.
        across = gap[known] * np.cos(angle)
        seen = across > tolerance
        agree[known] += np.abs(across) <= tolerance
        against[known] += seen
        through[known] |= seen & (angle <= own_angle[known])
        behind[k] = known[seen], uv[seen]
    upheld = agree >= _VOTES * np.maximum(against, 1)
    outvoted = {k: (uv[upheld[n], 1], uv[upheld[n], 0]) for k, (n, uv) in behind.items() if upheld[n].any()}
    result = np.zeros(image.valid.shape, dtype=bool)
    result[image.valid] = through & ~upheld
    return result, outvoted


def _without_islands(keep: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """Remove connected groups of fewer than `_SMALLEST_ISLAND` elements."""
    numbers, count = ndimage.label(keep)
    sizes = np.bincount(numbers.ravel(), minlength=count + 1)
    sizes[0] = 0
    return np.asarray(sizes >= _SMALLEST_ISLAND)[numbers]


_BEHIND = 1.4  # largest depth relative to the centre's, as in `matching.coarse_stereo`
_STEP_PX = 5.0  # edge of a cell, pixel widths on the surface: gaps of fewer pixels do not separate pieces
_MOST_CELLS = 256  # largest number of cells along a side
_SMALLEST = 0.05  # smallest piece that is kept, relative to the largest, in cells; used for open surfaces only


def subject_data(
    range_images: Sequence[RangeImage], blind: Collection[str], middle_world: Float64[Array, 3] | None
) -> list[Bool[Array, "h w"]]:
    """Per view and element, whether its datum belongs to the subject.

    If a view has no silhouette, only the largest piece is kept; else also pieces of at least 5 % of its size.

    Args:
        range_images: range images of all pairs.
        blind: pairs without silhouettes.
        middle_world: centre of the subject, world frame, mm.
    """
    keep = [image.valid.copy() for image in range_images]
    if middle_world is not None:
        for image, kept in zip(range_images, keep, strict=True):
            if image.name in blind and kept.any():
                depth = image.camera.camera_from_world.apply(image.valid_points_world())[:, 2]
                middle = float(image.camera.camera_from_world.apply(middle_world[None])[0, 2])
                kept[image.valid] = depth < _BEHIND * middle
    kept_images = [image.keeping(kept) for image, kept in zip(range_images, keep, strict=True)]
    points = np.concatenate([image.valid_points_world() for image in kept_images])
    if not len(points):
        return keep
    low, high = points.min(axis=0), points.max(axis=0)
    pixel_mm = float(np.nanmedian([image.pixel_mm() for image in kept_images]))
    edge = max(_STEP_PX * pixel_mm, float((high - low).max()) / _MOST_CELLS)
    cells = ((points - low) / edge).astype(np.intp)
    filled = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    filled[tuple(cells.T)] = True
    pieces, _ = ndimage.label(filled, structure=np.ones((3, 3, 3)))
    sizes = np.bincount(pieces[filled])
    least = 1.0 if blind else _SMALLEST
    chosen = (sizes >= least * sizes.max())[pieces[tuple(cells.T)]]
    start = 0
    for image, kept in zip(kept_images, keep, strict=True):
        count = int(np.count_nonzero(image.valid))
        kept[image.valid] = chosen[start : start + count]
        start += count
    return keep
