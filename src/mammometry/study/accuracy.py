"""A measured surface, boundary or volume against the truth of a simulated or rendered capture.

For studies and tests only: nothing that measures may import it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceAccuracy:
    """Distances between a measured and a true surface, mm."""

    mean_mm: float
    """Mean unsigned distance of the measured vertices from the true surface."""
    median_mm: float
    """Median of the same."""
    rms_mm: float
    """Root mean square of the same."""
    p95_mm: float
    """95th percentile of the same."""
    bias_mm: float
    """Mean signed distance: positive outside the true surface."""
    completeness: float
    """Share, 0…1, of the true vertices with measured surface within `tolerance_mm`."""
    tolerance_mm: float
    """What counts as there for the completeness."""
    points: int
    """Number of measured vertices compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VolumeAccuracy:
    """A measured volume beside the true one."""

    measured_cc: float
    true_cc: float
    covered: bool | None
    """Whether the 95 % interval holds the truth; None without an interval."""

    @property
    def error_cc(self) -> float:
        """Measured less true, cc."""
        return self.measured_cc - self.true_cc

    @property
    def error_percent(self) -> float:
        """The error in per cent of the truth."""
        return 100 * self.error_cc / self.true_cc


def compare_surfaces(
    measured: TriangleMesh,
    truth: TriangleMesh,
    *,
    of_measured: Bool[Array, " n"] | None = None,
    of_truth: Bool[Array, " m"] | None = None,
    tolerance_mm: float = 0.5,
) -> SurfaceAccuracy:
    """Compare a measured surface with the true one, both in one frame, mm.

    Args:
        measured: the surface under test.
        truth: the true surface, its faces counter-clockwise seen from outside.
        of_measured: vertices of `measured` to judge (for example the measured ones, without an invented back).
        of_truth: vertices of `truth` that ought to be there (for example those that two cameras see).
        tolerance_mm: distance within which a true vertex counts as measured.

    Raises:
        ValueError: nothing is left to compare.
    """
    points = measured.vertices if of_measured is None else measured.vertices[of_measured]
    wanted = truth.vertices if of_truth is None else truth.vertices[of_truth]
    if not len(points) or not len(wanted):
        raise ValueError(f"nothing to compare: {len(points)} measured and {len(wanted)} true vertices chosen")
    closest = closest_on_mesh(points, truth)
    side = _outside(points - closest.points, closest.points, closest.faces, truth)
    distance = closest.distances_mm
    found = closest_on_mesh(wanted, measured).distances_mm <= tolerance_mm
    return SurfaceAccuracy(
        mean_mm=float(distance.mean()),
        median_mm=float(np.median(distance)),
        rms_mm=float(np.sqrt(np.mean(distance**2))),
        p95_mm=float(np.percentile(distance, 95)),
        bias_mm=float((side * distance).mean()),
        completeness=float(found.mean()),
        tolerance_mm=tolerance_mm,
        points=len(points),
    )


def compare_volumes(
    measured_cc: float, true_cc: float, interval_cc: tuple[float, float] | None = None
) -> VolumeAccuracy:
    """Put a measured volume, and its 95 % interval where there is one, beside the true one, cc."""
    covered = None if interval_cc is None else bool(interval_cc[0] <= true_cc <= interval_cc[1])
    return VolumeAccuracy(measured_cc=measured_cc, true_cc=true_cc, covered=covered)


def _outside(
    offsets: Float64[Array, "n 3"], feet: Float64[Array, "n 3"], faces: Array, truth: TriangleMesh
) -> Float64[Array, " n"]:
    """+1 outside the true surface, −1 inside, by the normal interpolated at the closest point.

    A face's own normal would be wrong where the closest point lies on an edge or a corner.
    """
    a, b, c = np.moveaxis(truth.vertices[truth.faces[faces]], 1, 0)
    twice_area = np.cross(b - a, c - a)
    total = np.maximum((twice_area**2).sum(axis=1), 1e-30)
    weight_b = (np.cross(feet - a, c - a) * twice_area).sum(axis=1) / total
    weight_c = (np.cross(b - a, feet - a) * twice_area).sum(axis=1) / total
    weights = np.stack([1 - weight_b - weight_c, weight_b, weight_c], axis=1)
    normals = (truth.vertex_normals()[truth.faces[faces]] * weights[..., None]).sum(axis=1)
    return np.where((offsets * normals).sum(axis=1) >= 0, 1.0, -1.0)
