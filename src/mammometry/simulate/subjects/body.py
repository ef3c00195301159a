"""A trunk with shoulders, upper arms and neck, without breasts. Its skin is the zero level of a field.

Solid's frame: x to the patient's left, y to the head, z out of the chest, mm. y = 0 is at about the nipples' height,
z = 0 at the trunk's axis there. All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from skimage.measure import marching_cubes

from mammometry.geometry import Array, Bool, Float64, TriangleMesh
from mammometry.simulate.subjects.solid import smoothstep, waves

# Height, mm; width and depth there relative to those at the breasts; shift of the section's centre to the front, mm.
_SECTIONS = np.array(
    [
        [-420.0, 1.10, 1.02, 4.0],
        [-320.0, 1.04, 0.98, 6.0],
        [-220.0, 0.90, 0.90, 8.0],
        [-130.0, 0.92, 0.94, 4.0],
        [-50.0, 0.98, 1.00, 2.0],
        [20.0, 1.00, 1.00, 0.0],
        [90.0, 0.98, 0.92, -3.0],
        [140.0, 0.82, 0.77, -12.0],
        [180.0, 0.46, 0.60, -22.0],
        [215.0, 0.37, 0.55, -22.0],
        [300.0, 0.36, 0.55, -12.0],
    ]
)
_TOP_MM, _BOTTOM_MM = 250.0, -370.0  # heights at which neck and trunk are cut
_CUT_ROUNDING_MM = 14.0  # radius of the edges of these cuts
_SHOULDER_Y_MM = 138.0  # height of the shoulders' joints
NOTCH_Y_MM = 172.0
"""Height of the sternal notch."""
_STEP_MM = 1e-3  # step of the differences for the field's gradient


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyShape:
    """Measures of a trunk without breasts."""

    half_width_mm: float = 148.0
    """Half the chest's width at the breasts."""
    depth: float = 0.70
    """Ratio of the chest's depth to its width."""
    flatness: float = 2.5
    """Exponent of the sections: 2 is an ellipse, 3 is a flat chest with round sides."""
    skew: float = 0.0
    """Relative extra depth of the left half of the chest."""
    arm_out_rad: float = 0.6
    """Angle of the upper arms to the side, from hanging."""
    arm_back_rad: float = 0.2
    """Angle of the upper arms to the back, from hanging."""
    arm_mm: float = 46.0
    """Radius of the upper arm below the shoulder."""
    sternum_mm: float = 4.0
    """Depth of the hollow over the sternum."""
    rib_mm: float = 0.3
    """Height of the ribs' relief below and lateral to the breasts."""
    clavicle_mm: float = 4.0
    """Height of the collar-bones above the chest."""
    unevenness_mm: float = 1.0
    """Amplitude of the random unevenness."""
    belly_mm: float = 0.0
    """How far the belly extends in front of the trunk."""
    seed: int = 0
    """Seed of the unevenness."""


class TrunkField:
    """The trunk's field: negative inside, positive outside, approximately in millimetres near the skin."""

    def __init__(self, shape: BodyShape) -> None:
        self.shape = shape
        self._section = CubicSpline(_SECTIONS[:, 0], _SECTIONS[:, 1:])
        a, depth = shape.half_width_mm, shape.half_width_mm * shape.depth
        out, back = shape.arm_out_rad, shape.arm_back_rad
        self._shoulder = np.array([a - 2.0, _SHOULDER_Y_MM, -22.0])
        direction = np.array([np.sin(out), -np.cos(out), -np.tan(back)])
        self._elbow = self._shoulder + 400.0 * direction / np.linalg.norm(direction)
        front = self._front_mm(NOTCH_Y_MM - 8.0, depth)
        self._collar = (
            np.array([20.0, NOTCH_Y_MM - 10.0, front - 8.0]),
            np.array([a - 14.0, _SHOULDER_Y_MM + 24.0, 4.0]),
        )

    def _front_mm(self, y: float, depth: float) -> float:
        _, deep, forward = self._section(y)
        return float(forward + deep * depth)

    def __call__(self, points: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """Field at points of the solid's frame."""
        trunk, arm = self._parts(points)
        both = _union(trunk, arm, 55.0)
        y = points[:, 1]
        return -_union(-_cut(both, y - _TOP_MM), -_cut(both, _BOTTOM_MM - y), 1.0)

    def in_arm(self, points: Float64[Array, "n 3"]) -> Bool[Array, " n"]:
        """Mask of the points that belong to an arm instead of the trunk."""
        trunk, arm = self._parts(points)
        return arm < trunk

    def gradient(self, points: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Gradient of the field, by finite differences."""
        here = self(points)
        steps = np.eye(3) * _STEP_MM
        return np.stack([(self(points + step) - here) / _STEP_MM for step in steps], axis=1)

    def onto(
        self, points: Float64[Array, "n 3"], gradient: Float64[Array, "n 3"], rounds: int = 2
    ) -> Float64[Array, "n 3"]:
        """Move points near the skin onto it by Newton steps. `gradient` may be that of nearby points."""
        step = gradient / np.maximum((gradient**2).sum(axis=1, keepdims=True), 1e-12)
        for _ in range(rounds):
            points = points - self(points)[:, None] * step
        return points

    def outwards(
        self, start: Float64[Array, "n 3"], direction: Float64[Array, 3], reach_mm: float
    ) -> Float64[Array, "n 3"]:
        """Points of the skin between inner points and those `reach_mm` farther in a direction (bisection)."""
        low, high = np.zeros(len(start)), np.full(len(start), reach_mm)
        for _ in range(40):
            middle = 0.5 * (low + high)
            inside = self(start + middle[:, None] * direction) < 0
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        return start + (0.5 * (low + high))[:, None] * direction

    def on_front(self, x: Array, y: Array) -> Float64[Array, "n 3"]:
        """Points of the trunk's front skin at (x, y)."""
        return self.outwards(np.stack([x, y, np.zeros(len(x))], axis=1), np.array([0.0, 0.0, 1.0]), 260.0)

    def coarse_mesh(self, step_mm: float = 7.0) -> TriangleMesh:
        """Closed triangulation of the skin with edges of about `step_mm` and vertices on the skin."""
        reach = np.abs(self._elbow[0]) + 70.0
        low = np.array([-reach, _BOTTOM_MM - 12.0, -250.0])
        high = np.array([reach, _TOP_MM + 12.0, max(190.0 + 1.5 * self.shape.belly_mm, self._elbow[2] + 70.0)])
        axes = [np.arange(a, b + step_mm, step_mm) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        field = self(grid.reshape(-1, 3)).reshape(grid.shape[:3])
        vertices, faces, _, _ = marching_cubes(  # type: ignore[no-untyped-call]
            field, 0.0, spacing=(step_mm,) * 3, gradient_direction="ascent"
        )
        vertices = vertices.astype(np.float64) + low
        faces = faces.astype(np.int32)
        for _ in range(4):  # smooths the slivers of marching cubes along the skin
            vertices = self.onto(_smoothed(vertices, faces), self.gradient(vertices))
        mesh = TriangleMesh(vertices=vertices, faces=faces)
        return mesh if mesh.volume_mm3() > 0 else TriangleMesh(vertices=vertices, faces=faces[:, ::-1].copy())

    def _parts(self, points: Float64[Array, "n 3"]) -> tuple[Float64[Array, " n"], Float64[Array, " n"]]:
        """Fields of the trunk and of the nearer arm."""
        shape = self.shape
        x, y, z = points.T
        wide, deep, forward = self._section(np.clip(y, _SECTIONS[0, 0], _SECTIONS[-1, 0])).T
        a, b = shape.half_width_mm * wide, shape.half_width_mm * shape.depth * deep
        b = b * (1.0 + 0.5 * shape.skew * np.tanh(x / (0.5 * shape.half_width_mm)))
        aside, ahead = np.abs(x) / a, np.abs(z - forward) / b
        p = shape.flatness
        if shape.belly_mm:
            b = b + shape.belly_mm * np.exp(-(((y + 250.0) / 85.0) ** 2)) * smoothstep(0.0, 60.0, z)
            ahead = np.abs(z - forward) / b
        trunk = ((aside**p + ahead**p) ** (1.0 / p) - 1.0) * np.minimum(a, b)
        mirrored = np.stack([np.abs(x), y, z], axis=1)
        collar = _capsule(mirrored, *self._collar, 7.0, 9.0)
        trunk = _union(trunk, collar + 4.0 - shape.clavicle_mm, 16.0)
        bridge = _capsule(
            mirrored, np.array([44.0, 178.0, -40.0]), self._shoulder + np.array([-14.0, 8.0, -6.0]), 22.0, 38.0
        )
        trunk = _union(trunk, bridge, 40.0) + self._details(points, np.abs(x), z)
        return trunk, _capsule(mirrored, self._shoulder, self._elbow, shape.arm_mm + 7.0, shape.arm_mm - 6.0)

    def _details(self, points: Array, aside: Array, z: Array) -> Float64[Array, " n"]:
        """Hollows (positive) and ridges (negative) of the trunk's skin, mm."""
        shape, y = self.shape, points[:, 1]
        front, back = smoothstep(10.0, 50.0, z), smoothstep(-10.0, -60.0, z)
        chest = smoothstep(-150.0, -60.0, y) * smoothstep(185.0, 130.0, y)
        hollow = shape.sternum_mm * np.exp(-((aside / 17.0) ** 2)) * chest * front
        notch = 7.0 * np.exp(-(aside**2 + (y - NOTCH_Y_MM - 4.0) ** 2) / 11.0**2) * front
        spine = 9.0 * np.exp(-((aside / 20.0) ** 2)) * back
        rib = np.sin(2.0 * np.pi * (y + 0.35 * aside) / 27.0)
        ribs = shape.rib_mm * rib * smoothstep(-170.0, -120.0, y) * smoothstep(95.0, 40.0, y)
        ribs = ribs * smoothstep(25.0, 70.0, aside)
        rng = np.random.default_rng([shape.seed, 81])
        return hollow + notch + spine + ribs + shape.unevenness_mm * waves(points, rng, shortest_mm=70, longest_mm=240)


def _capsule(points: Array, start: Array, end: Array, first_mm: float, last_mm: float) -> Float64[Array, " n"]:
    """Approximate distance from a bar with round ends and varying radius."""
    along = end - start
    share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
    distance: Float64[Array, " n"] = np.linalg.norm(points - start - share[:, None] * along, axis=1)
    return distance - (first_mm + (last_mm - first_mm) * share)


def _union(a: Array, b: Array, blend_mm: float) -> Float64[Array, " n"]:
    """The smaller of two fields, rounded where they are close. Cubic, twice differentiable."""
    near = np.maximum(blend_mm - np.abs(a - b), 0.0) / blend_mm
    return np.minimum(a, b) - near**3 * (blend_mm / 6.0)


def _cut(field: Array, beyond: Array) -> Float64[Array, " n"]:
    """Part of a field on the negative side of a plane, with a rounded edge."""
    return -_union(-field, -beyond, _CUT_ROUNDING_MM)


def _smoothed(vertices: Array, faces: Array) -> Float64[Array, "n 3"]:
    """Vertices moved halfway to the mean of their neighbours."""
    total, count = np.zeros_like(vertices), np.bincount(faces.ravel(), minlength=len(vertices)) * 2.0
    for corner in range(3):
        for other in (1, 2):
            neighbour = vertices[faces[:, (corner + other) % 3]]
            for axis in range(3):
                total[:, axis] += np.bincount(faces[:, corner], neighbour[:, axis], minlength=len(vertices))
    return 0.5 * (vertices + total / count[:, None])
