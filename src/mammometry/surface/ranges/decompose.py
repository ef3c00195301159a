"""Decomposition of range images into labelled patches (paper 2.6.1).

Done for each ordered pair of views.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import ndimage

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Int32, UInt8
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.surface.ranges.visibility import Label, compare
from mammometry.surface.settings import DecomposeSettings


@value(eq=False)
class Patches:
    """Every range image labelled against every other one."""

    labels: Mapping[tuple[str, str], UInt8[Array, "h w"]]
    """(A, B) → label of each element of A against B (`visibility.Label`). OUTSIDE where A has no datum."""
    patches: Mapping[tuple[str, str], Int32[Array, "h w"]]
    """(A, B) → patch of each element of A, from 1: connected elements of one label. 0 without datum."""
    epsilon_mm: float
    """Half-width of the overlapping zone used, mm."""


def decompose(range_images: Sequence[RangeImage], settings: DecomposeSettings = DecomposeSettings()) -> Patches:
    """Label all range images against one another, and group equal neighbours.

    Paper 2.6.1. Elements are adjacent by their four sides; those that another view does not see (OUTSIDE) form patches
    too.
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
    return Patches(labels=labels, patches=patches, epsilon_mm=settings.epsilon_mm)


def _components(labels: UInt8[Array, "h w"], valid: Bool[Array, "h w"]) -> Int32[Array, "h w"]:
    """Number the 4-connected regions of equal label from 1. Only valid elements count."""
    numbers = np.zeros(labels.shape, dtype=np.int32)
    count = 0
    for label in Label:
        regions, n = ndimage.label(valid & (labels == label))
        numbers[regions > 0] = regions[regions > 0] + count
        count += n
    return numbers
