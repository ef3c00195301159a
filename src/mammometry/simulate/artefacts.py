"""Virtual devices with known errors for acceptance tests."""

from __future__ import annotations

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh

_WAVES = 64  # number of cosines of which errors common to neighbouring points are composed


DEMO_DEVICE = """\
format = 1
[device]
name = "Virtual device"
person = "demo"
date = 2026-11-29
software = "drawn surfaces with errors"
units = "mm"
[sphere]
diameter_mm = 145.0
diameter_std_mm = 0.02
form_std_mm = 0.02
source = "drawn"
[bar]
distance_mm = 300.0
distance_std_mm = 0.03
diameter_mm = 60.0
diameter_std_mm = 0.02
source = "drawn"
[plane]
flatness_std_mm = 0.02
source = "drawn"
[cast]
volume_cc = 400.0
volume_std_cc = 0.5
source = "drawn"
"""
"""Description of the demo's test."""


@value
class DeviceErrors:
    """Errors of a virtual device."""

    scale: float = 0.0
    """Relative error of lengths."""
    noise_mm: float = 0.0
    """Standard deviation of errors along the normal, independent from point to point."""
    shared_mm: float = 0.0
    """Standard deviation of errors common to neighbouring points."""
    shared_over_mm: float = 8.0
    """Distance within which points have similar errors."""


def measured_mesh(mesh: TriangleMesh, errors: DeviceErrors, rng: np.random.Generator) -> TriangleMesh:
    """A mesh as measured by a device with these errors."""
    offsets = errors.noise_mm * rng.normal(size=len(mesh.vertices))
    offsets += errors.shared_mm * shared_errors(mesh.vertices, errors.shared_over_mm, rng)
    vertices = mesh.vertices + offsets[:, None] * mesh.vertex_normals()
    return TriangleMesh(vertices=(1.0 + errors.scale) * vertices, faces=mesh.faces)


def shared_errors(points: Float64[Array, "n 3"], alike_mm: float, rng: np.random.Generator) -> Float64[Array, " n"]:
    """Random numbers of unit variance whose correlation falls with distance as a Gaussian."""
    waves = rng.normal(0.0, 1.0 / alike_mm, (3, _WAVES))
    return np.asarray(np.sqrt(2.0 / _WAVES) * np.cos(points @ waves + rng.uniform(0, 2 * np.pi, _WAVES)).sum(axis=1))


DEMO_ERRORS = DeviceErrors(scale=0.0003, noise_mm=0.03, shared_mm=0.03)
"""Errors of the demo's device, similar to those of a calibrated rig."""
