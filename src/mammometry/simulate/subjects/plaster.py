"""Plaster breasts of exactly known volume, from a hemisphere to a ptotic breast with a deep fold."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from mammometry.geometry import Array, Float64, TriangleMesh
from mammometry.simulate.subjects.registry import SubjectRequest, add_subject, numbered
from mammometry.simulate.subjects.shapes import back_faces, disc
from mammometry.simulate.subjects.solid import SubjectSolid, rounded_mesh, smoothstep, waves

TABLE_1_WATER_CC = (364.6, 434.7, 579.0, 231.1, 433.4, 591.6, 596.6, 100.4, 863.1)
"""Volumes of the paper's nine plaster models by water displacement (Table 1), cc."""


LEAST_CC, MOST_CC = 20, 2000
"""Smallest and largest volume of `plaster_20cc` to `plaster_2000cc`."""
_OF_VOLUME = re.compile(r"plaster_([0-9]{1,4})cc")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlasterShape:
    """Volume of a plaster breast, and proportions that do not change with its scale."""

    volume_cc: float = 400.0
    """Volume of the finished solid, cc."""
    projection: float = 0.85
    """Height above the back, in radii of the base."""
    width: float = 1.05
    """Ratio of the base's width to its height."""
    sag: float = 0.45
    """Sagging of the mass, in projections: 0 is a hemisphere, 0.8 is ptotic with a deep undercut."""
    fold: float = 0.10
    """Depth of the groove under the breast, in radii of the base."""
    lateral: float = 0.10
    """Lateral direction of the nipple, in projections."""
    upper_slope: float = 0.15
    """Flattening of the upper half."""
    outline: tuple[float, float, float, float] = (0.02, 0.5, 0.015, 1.0)
    """Second and third harmonic of the base's outline: amplitude in radii and phase in rad of each."""
    back_radius_mm: float | None = None
    """Radius of the cylinder (axis along y) over which the back is bent. None: a flat back."""
    irregularity_mm: float = 0.5
    """Amplitude of the unevenness of a hand-made model, mm."""
    nipple_mm: float = 4.0
    """Height of the nipple above the areola, mm."""
    areola_mm: float = 17.0
    """Radius of the areola, mm."""


def plaster_shape(name: str, seed: int) -> PlasterShape:
    """Draw the shape of a plaster model by seed.

    Args:
        name: ``plaster`` for any of the family, or ``plaster_1`` … ``plaster_9`` for one with a volume within 3 % of
            the paper's Table 1; even ones have a back bent over a cylinder. ``plaster_60cc`` has that volume and a flat
            back.
        seed: seed of all random values.

    Raises:
        ValueError: the name is unknown.
    """
    number = 0
    named = _OF_VOLUME.fullmatch(name)
    if named and LEAST_CC <= int(named[1]) <= MOST_CC:
        number = len(TABLE_1_WATER_CC) + int(named[1])
    elif name != "plaster":
        try:
            number = int(name.removeprefix("plaster_"))
        except ValueError:
            number = -1
        if not 1 <= number <= len(TABLE_1_WATER_CC):
            raise ValueError(
                f"plaster models are plaster, plaster_1 … plaster_9, and plaster_{LEAST_CC}cc … plaster_{MOST_CC}cc, "
                f"found {name!r}"
            )
    rng = np.random.default_rng([seed, number, 71])
    if named:
        volume_cc, curved = float(named[1]), False
    elif number:
        volume_cc = TABLE_1_WATER_CC[number - 1] * rng.uniform(0.97, 1.03)
        curved = number % 2 == 0
    else:
        volume_cc = float(np.exp(rng.uniform(math.log(80.0), math.log(1000.0))))
        curved = bool(rng.random() < 0.5)
    # Larger breasts hang more.
    heaviness = np.clip(math.log(volume_cc / 100.0) / math.log(9.0), 0.0, 1.0)
    return PlasterShape(
        volume_cc=float(volume_cc),
        projection=rng.uniform(0.72, 0.95),
        width=rng.uniform(0.97, 1.12),
        sag=float(0.15 + 0.35 * heaviness + rng.uniform(-0.1, 0.2)),
        fold=rng.uniform(0.03, 0.15),
        lateral=rng.uniform(-0.18, 0.18),
        upper_slope=rng.uniform(0.0, 0.25),
        outline=(
            rng.uniform(0.0, 0.03),
            rng.uniform(0.0, 2 * math.pi),
            rng.uniform(0.0, 0.025),
            rng.uniform(0.0, 2 * math.pi),
        ),
        back_radius_mm=rng.uniform(180.0, 280.0) if curved else None,
        irregularity_mm=rng.uniform(0.3, 0.8),
        nipple_mm=rng.uniform(2.5, 6.0),
        areola_mm=rng.uniform(14.0, 20.0),
    )


def plaster(shape: PlasterShape, *, name: str = "plaster", seed: int = 0, edge_mm: float = 0.7) -> SubjectSolid:
    """Make an uneven half ellipsoid that sags over an undercut fold, with nipple and areola.

    Args:
        shape: its measures.
        name: its name.
        seed: seed of the unevenness.
        edge_mm: 95 % of the breast side's edges are shorter; the others are in the fold and on the nipple.
    """
    rho, theta, faces, rings = disc(48)
    coarse = _dome(rho, theta, shape)
    rings = max(8, math.ceil(48 * _long_edge(coarse, faces) / edge_mm))
    rho, theta, faces, rings = disc(rings)
    front = _dome(rho, theta, shape)

    base_radius = _base_radius(shape)
    normals = TriangleMesh(vertices=front, faces=faces).vertex_normals()
    rng = np.random.default_rng([seed, 72])
    unevenness = waves(front, rng, shortest_mm=0.4 * base_radius, longest_mm=1.2 * base_radius)
    front += normals * (shape.irregularity_mm * unevenness * (1.0 - rho**6))[:, None]

    normals = TriangleMesh(vertices=front, faces=faces).vertex_normals()
    apex = int(np.argmin(np.hypot(rho * np.cos(theta) - 0.02, rho * np.sin(theta) + rng.uniform(0.02, 0.14))))
    nipple, direction = front[apex].copy(), normals[apex].copy()
    distance = np.linalg.norm(front - nipple, axis=1)
    wobble = 1.0 + 0.04 * waves(front, rng, shortest_mm=12.0, longest_mm=30.0)
    areola = 1.0 - smoothstep(0.93, 1.07, distance * wobble / shape.areola_mm)
    puff = 0.08 * shape.areola_mm * np.clip(1.0 - (distance / (1.2 * shape.areola_mm)) ** 2, 0.0, None) ** 2
    bud = shape.nipple_mm * (1.0 - smoothstep(0.15, 1.0, distance / (0.38 * shape.areola_mm)))
    front += direction * (puff + bud)[:, None]
    facing = smoothstep(-0.2, 0.2, normals @ direction)
    areola = np.clip(areola * facing, 0.0, 1.0)

    rim = front[rho == 1.0]
    back = _flat_back(rim, rho, theta)
    vertices = np.concatenate([front, back])
    all_faces = np.concatenate([faces, back_faces(faces, len(front), len(rim))])
    vertices *= (shape.volume_cc * 1000.0 / _volume(vertices, all_faces)) ** (1.0 / 3.0)
    if shape.back_radius_mm is not None:
        vertices = _bent(vertices, shape.back_radius_mm)
        # Edges on a bent surface are straight, so a last scaling by about a millionth is needed.
        vertices *= (shape.volume_cc * 1000.0 / _volume(vertices, all_faces)) ** (1.0 / 3.0)
    mesh = rounded_mesh(vertices, all_faces)
    vertices = mesh.vertices
    boundary = vertices[: len(front)][rho == 1.0]
    overhang_mm = boundary[:, 1].min() - vertices[: len(front), 1].min()
    return SubjectSolid(
        name=name,
        subject_kind="model",
        mesh=mesh,
        back_vertices=len(back),
        areola=np.concatenate([areola, np.zeros(len(back))]).astype(np.float32),
        base_boundary=boundary.copy(),
        facts={
            "kind": "plaster",
            "back": "flat" if shape.back_radius_mm is None else "curved: bent over a cylinder along y",
            "back_radius_mm": shape.back_radius_mm,
            "areola_mm": shape.areola_mm,
            "overhang_mm": float(overhang_mm),
            "nipple_solid": [float(value) for value in vertices[apex]],
        },
    )


@add_subject("plaster", has=numbered("plaster"), choices="plaster, plaster_1 … plaster_9, plaster_60cc")
def _plaster(wanted: SubjectRequest) -> SubjectSolid:
    shape = plaster_shape(wanted.name, wanted.seed)
    return plaster(shape, name=wanted.name, seed=wanted.seed, edge_mm=wanted.edge_mm)


def _dome(rho: Array, theta: Array, shape: PlasterShape) -> Float64[Array, "n 3"]:
    """Breast side over the unit disc (rho, theta), at about its final size, with the rim in z = 0."""
    radius = _base_radius(shape)
    height = shape.projection * radius
    angle = 0.5 * math.pi * rho
    level = np.cos(angle)
    level[rho == 1.0] = 0.0
    a2, phase2, a3, phase3 = shape.outline
    ring = np.sin(angle) * (
        1.0 + (1.0 - level) * (a2 * np.cos(2 * (theta - phase2)) + a3 * np.cos(3 * (theta - phase3)))
    )
    downward = (0.5 * (1.0 - np.sin(theta))) ** 3
    ring *= 1.0 - shape.fold * downward * np.exp(-((level / 0.25) ** 2))
    x = radius * shape.width * ring * np.cos(theta)
    y = radius * ring * np.sin(theta)
    z = height * level * (1.0 - shape.upper_slope * smoothstep(0.0, 1.0, ring * np.sin(theta)))
    x = x + shape.lateral * height * level
    y = y - shape.sag * height * level
    return np.stack([x, y, z], axis=1)


def _base_radius(shape: PlasterShape) -> float:
    """Radius of a half ellipsoid of given proportions and volume, mm."""
    return float((shape.volume_cc * 1000.0 / (2.0 / 3.0 * math.pi * shape.projection * shape.width)) ** (1.0 / 3.0))


def _flat_back(rim: Float64[Array, "r 3"], rho: Array, theta: Array) -> Float64[Array, "b 3"]:
    """Interior points of the flat back: the rim contracted towards its mean."""
    inside = rho < 1.0
    angle = np.arange(len(rim)) * (2 * math.pi / len(rim))
    outline = np.stack([np.interp(theta[inside], angle, rim[:, k], period=2 * math.pi) for k in range(3)], axis=1)
    middle = rim.mean(axis=0)
    return middle + (outline - middle) * rho[inside, None]


def _bent(vertices: Float64[Array, "n 3"], radius_mm: float) -> Float64[Array, "n 3"]:
    """Shift every point by the sagitta of a cylinder along y, into which the plane z = 0 is bent.

    This shear preserves the volume. The sides do not flare, so that the rim remains the widest part.
    """
    sagitta = radius_mm - np.sqrt(radius_mm**2 - vertices[:, 0] ** 2)
    return np.stack([vertices[:, 0], vertices[:, 1], vertices[:, 2] - sagitta], axis=1)


def _long_edge(vertices: Array, faces: Array) -> float:
    """95th percentile of the edges' lengths, mm."""
    corners = vertices[faces]
    return float(np.percentile(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), 95.0))


def _volume(vertices: Array, faces: Array) -> float:
    return TriangleMesh(vertices=vertices, faces=faces).volume_mm3()
