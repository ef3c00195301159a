"""Objects other than the subject, in uniform colours: a dark board, a cluttered room, hair.

All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mammometry.geometry import Array, Float32, Float64, Int32, TriangleMesh, UInt8

BOARD_MM = (270.0, 290.0)
"""Width and height of the dark board behind a flat back."""
_BOARD_STEP_MM = 3.0  # distance of the board's vertices, which store its shadows
_OBJECTS = 240  # boxes of the clutter, including the room itself
_ROOM_MM = (1150.0, 1600.0)  # range of the clutter's distance from the rig's centre, mm: beyond all cameras and flashes
_WALL_MM = 2100.0  # distance of the room's walls from the centre: beyond all boxes
_SIDES = 3  # sides of a hair's tube
_JOINTS = 6  # points of a hair's centre line
_HAIR_RADIUS_MM = 0.05  # radius of a hair
_HAIR_LENGTH_MM = (4.0, 14.0)  # range of hairs' lengths, uniformly distributed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Props:
    """Faces that are not the subject's."""

    vertices: Float64[Array, "n 3"]
    normals: Float64[Array, "n 3"]
    faces: Int32[Array, "m 3"]
    material: UInt8[Array, " m"]
    """Index of each face's colour, from 0."""


def board(z: float) -> Props:
    """Board in the plane z, centred, facing +z, with vertices dense enough for shadows."""
    columns, rows = (math.ceil(side / _BOARD_STEP_MM) for side in BOARD_MM)
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, columns + 1) * BOARD_MM[0], np.linspace(-0.5, 0.5, rows + 1) * BOARD_MM[1]
    )
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    a = row * (columns + 1) + column
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]).astype(np.int32)
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)
    normals = np.broadcast_to([0.0, 0.0, 1.0], vertices.shape)
    return Props(vertices=vertices, normals=normals, faces=faces, material=np.zeros(len(faces), dtype=np.uint8))


def room(seed: int) -> tuple[Props, Float64[Array, "k 3"]]:
    """Boxes around the rig, each with its own material, and the reflectances of the materials."""
    rng = np.random.default_rng([seed, 81])
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    sides = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    vertices, normals = [], []
    faces: list[list[list[int]]] = []
    for number in range(_OBJECTS):
        # Uniformly over all directions, so that there is something behind the subject from every side.
        height = 1.0 - (2 * number + 1) / _OBJECTS
        azimuth = number * math.pi * (3.0 - math.sqrt(5.0)) + rng.uniform(-0.3, 0.3)
        towards = np.array([math.sqrt(1 - height**2) * math.cos(azimuth), height, 0.0])
        towards[2] = math.sqrt(1 - height**2) * math.sin(azimuth)
        size = rng.uniform(60.0, 320.0, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        centre = towards * (rng.uniform(*_ROOM_MM) + 0.5 * np.linalg.norm(size))
        if number == _OBJECTS - 1:  # the last is the room itself
            turn, size, centre = np.eye(3), np.full(3, 2.0 * _WALL_MM), np.zeros(3)
        box = (corners * size) @ turn.T + centre
        for side in sides:
            first = 4 * len(faces)
            normal = np.cross(box[side[1]] - box[side[0]], box[side[2]] - box[side[0]])
            vertices.append(box[side])
            normals.append(np.broadcast_to(normal / np.linalg.norm(normal), (4, 3)))
            faces.append([[first, first + 1, first + 2], [first, first + 2, first + 3]])
    material = np.repeat(np.arange(_OBJECTS), 2 * len(sides)).astype(np.uint8)
    colours = np.clip(rng.uniform(0.05, 0.8, (_OBJECTS, 1)) * rng.uniform(0.5, 1.4, (_OBJECTS, 3)), 0.0, 0.9)
    props = Props(
        vertices=np.concatenate(vertices),
        normals=np.concatenate(normals),
        faces=np.concatenate(faces).astype(np.int32),
        material=material,
    )
    return props, colours


def strands(
    mesh: TriangleMesh, normals: Float64[Array, "n 3"], faces: Array, per_cm2: float, seed: int
) -> tuple[Float32[Array, "k j 3"], Int32[Array, " k"]]:
    """Grow hairs on some faces of a mesh: centre lines, and the vertex nearest to each root.

    They leave the skin obliquely, point towards −y, and bend.

    Args:
        mesh: the subject.
        normals: unit normals at its vertices.
        faces: indices of the faces with hair.
        per_cm2: number of hairs per cm².
        seed: seed of all random values.
    """
    rng = np.random.default_rng([seed, 82])
    corners = mesh.vertices[mesh.faces[faces]]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    count = round(float(area.sum()) / 100.0 * per_cm2)
    chosen = faces[rng.choice(len(faces), size=count, p=area / area.sum())]
    weights = rng.dirichlet(np.ones(3), size=count)
    indices = mesh.faces[chosen]
    roots = (weights[:, :, None] * mesh.vertices[indices]).sum(axis=1)
    out = (weights[:, :, None] * normals[indices]).sum(axis=1)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    lie = np.array([0.0, -1.0, 0.0]) + rng.normal(0.0, 0.5, (count, 3))
    lie -= (lie * out).sum(axis=1, keepdims=True) * out
    lie /= np.maximum(np.linalg.norm(lie, axis=1, keepdims=True), 1e-9)
    length = rng.uniform(*_HAIR_LENGTH_MM, count)[:, None, None]
    along = np.linspace(0.0, 1.0, _JOINTS)[None, :, None]
    rise = rng.uniform(0.15, 0.45, count)[:, None, None]
    side = np.cross(out, lie)[:, None] * rng.normal(0.0, 0.2, count)[:, None, None]
    lines = roots[:, None] + length * (along * lie[:, None] + side * along**2)
    lines += length * out[:, None] * rise * (along - 0.6 * along**2)
    return lines.astype(np.float32), indices[np.arange(count), weights.argmax(axis=1)].astype(np.int32)


def tubes(lines: Float32[Array, "k j 3"]) -> Props:
    """Three-sided tubes of 0.1 mm around hairs' centre lines. Vertices are ordered by hair."""
    count = len(lines)
    along = np.gradient(lines.astype(np.float64), axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    helper = np.array([0.3, 0.2, 0.93])
    a = np.cross(along, helper)
    a /= np.linalg.norm(a, axis=2, keepdims=True)
    b = np.cross(along, a)
    angle = np.arange(_SIDES) * (2 * math.pi / _SIDES)
    ring = np.cos(angle)[:, None] * a[:, :, None] + np.sin(angle)[:, None] * b[:, :, None]
    vertices = lines[:, :, None] + _HAIR_RADIUS_MM * ring
    joint, side = (grid.ravel() for grid in np.mgrid[0 : _JOINTS - 1, 0:_SIDES])
    first, second = joint * _SIDES + side, joint * _SIDES + (side + 1) % _SIDES
    one = np.concatenate(
        [np.stack([first, second, second + _SIDES], 1), np.stack([first, second + _SIDES, first + _SIDES], 1)]
    )
    faces = (one[None] + (np.arange(count) * _JOINTS * _SIDES)[:, None, None]).reshape(-1, 3)
    return Props(
        vertices=vertices.reshape(-1, 3),
        normals=ring.reshape(-1, 3),
        faces=faces.astype(np.int32),
        material=np.zeros(len(faces), dtype=np.uint8),
    )
