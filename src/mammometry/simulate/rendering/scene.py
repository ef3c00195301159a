"""Scene in front of the cameras: one mesh with attributes for shading.

Light is computed once per scene, because the visible share of each flash and of the surroundings at a vertex, and the
light below the skin, do not depend on the camera. Flashes are soft boxes, so shadows have soft edges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.sparse import csr_matrix

from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float32, Float64, Int32, Transform, TriangleMesh, UInt8
from mammometry.geometry.directions import even_directions
from mammometry.simulate.rendering import props
from mammometry.simulate.rendering.props import Props
from mammometry.simulate.rendering.skin import SkinReflectance
from mammometry.simulate.subjects.solid import SubjectSolid


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SubjectMotion:
    """Velocities of the subject, rig frame. Sway and breathing do not reverse within a fifth of a second."""

    sway_mm_s: Float64[Array, 3]
    """Velocity of the whole body."""
    turn_rad_s: Float64[Array, 3]
    """Rotation of the whole body about the rig's centre (axis times angle)."""
    breath_mm_s: Float64[Array, 3]
    """Additional velocity of the front of the chest."""
    chest: Float64[Array, 3]
    """Point with the largest motion by breathing, mm."""
    reach_mm: float = 130.0
    """Gaussian σ of the motion by breathing around its centre, mm: about the size of a chest. Made up."""

    def at(self, points: Float64[Array, "n 3"], seconds: float) -> Float64[Array, "n 3"]:
        """Positions of points after some seconds. Second-order terms (a micrometre) are neglected."""
        share = np.exp(-0.5 * ((points - self.chest) ** 2).sum(axis=1) / self.reach_mm**2)
        speed = self.sway_mm_s + np.cross(self.turn_rad_s, points) + share[:, None] * self.breath_mm_s
        moved: Float64[Array, "n 3"] = points + seconds * speed
        return moved


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prop:
    """An object such as a rail, a wall or a towel, rig frame, mm."""

    props: Props
    colours: Float64[Array, "k 3"]
    """Reflectance of each material of `props`, RGB."""
    smooth: float = 0.5
    """Uniformity of its colours: 0 is mottled like cloth, 1 is uniform."""
    curved: bool = False
    """Whether its faces form one smooth surface instead of flat sides with edges."""
    moves: bool = False
    """Whether it moves with the subject."""
    glow: float = 0.0
    """Emitted light, relative to its brightness under ambient light."""


SOFT_BOX_RADIUS_MM = 90.0
"""Radius of the disc of each flash. Made up, like the other sizes here."""
_SOFT_BOX_SAMPLES = 4  # rays from a vertex to each flash
_SKY_SAMPLES = 10  # rays from a vertex to its surroundings
_LIFT_MM = 0.05  # height above the skin at which a ray starts, so that it does not hit its own face
BACKDROP_GAP_MM = 0.8
"""Distance of the board behind a flat back."""
SCATTER, LIGHTS = 5, 8
"""First columns of `StudioScene.attributes` with scattered light, and with shares of lights."""
_BACKDROP_REFLECTANCE = 0.022  # reflectance of the dark board
_HAIR_RGB = (0.045, 0.03, 0.02)  # reflectance
_ROOM_LIGHT = 2.2
"""Brightness of a cluttered room's objects relative to the subject's ambient light: only the room lights them."""


@value(eq=False)
class StudioScene:
    """A lit subject in a room, with hair and perhaps a backdrop, rig frame, mm."""

    mesh: TriangleMesh
    """The subject's vertices and faces first, then all others."""
    subject_faces: int
    """Number of the subject's faces."""
    subject_vertices: int
    """Number of the subject's vertices."""
    vertices: Float32[Array, "n 3"]
    """The mesh's vertices, as used by the rays."""
    painted: Float32[Array, "n 3"]
    """Positions of the vertices to which their colours belong. They differ if the subject has moved since."""
    moves: Bool[Array, " n"]
    """Vertices that move with the subject."""
    attributes: Float32[Array, "n a"]
    """Per vertex: normal (3), areola, visible share of the surroundings, irradiance by light below the surface (RGB),
    visible share of each light. If there are marks, also factors of the skin's colour (RGB)."""
    material: UInt8[Array, " m"]
    """Per face: 0 is skin, k row k of `plain_colours`, from 1."""
    piece: Int32[Array, " m"]
    """For each face, the index of its smooth piece, 0 for the subject. Edges between pieces are sharp."""
    plain_colours: Float64[Array, "k 3"]
    """Reflectance of everything except skin, RGB. The backdrop and the hairs come first."""
    strands: Float32[Array, "h j 3"]
    """Centre lines of the hairs."""
    lights: Float64[Array, "l 4"]
    """Position, mm, and irradiance × mm² at distance 1."""
    rays: EmbreeScene
    """Finds the first face along a ray."""

    @property
    def subject(self) -> TriangleMesh:
        """The subject's closed mesh."""
        return TriangleMesh(
            vertices=self.mesh.vertices[: self.subject_vertices], faces=self.mesh.faces[: self.subject_faces]
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Room:
    """Objects around the subject or on its skin."""

    backdrop: bool = False
    """Whether there is a dark board of 270 × 290 mm, 0.8 mm behind the lowest point of the solid's back."""
    clutter: bool = False
    """Whether the rig is in a cluttered room."""
    things: Sequence[Prop] = ()
    """All other objects, rig frame."""


def light_scene(
    solid: SubjectSolid,
    rig_from_solid: Transform,
    lights: Float64[Array, "l 4"],
    room: Room = Room(),
    *,
    skin: SkinReflectance = SkinReflectance(),
    seed: int = 0,
) -> StudioScene:
    """Place a solid in the rig, and compute the light.

    Args:
        solid: the subject.
        rig_from_solid: its pose. The mesh in the rig's frame is rounded to float32, as the rays use it.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        room: other objects, which cast and receive shadows.
        skin: its softness and hair.
        seed: seed of the hair and of the room.
    """
    placed = rig_from_solid.apply(solid.mesh.vertices).astype(np.float32)
    normals = _smooth_normals(solid, rig_from_solid)
    body = TriangleMesh(vertices=placed.astype(np.float64), faces=solid.mesh.faces)
    hidden = np.zeros(len(placed), dtype=bool)
    hidden[len(placed) - solid.back_vertices :] = True
    pieces = [placed]
    faces, normal_pieces = [solid.mesh.faces], [normals]
    material = [np.zeros(len(solid.mesh.faces), dtype=np.uint8)]
    colours = np.array([[_BACKDROP_REFLECTANCE] * 3, _HAIR_RGB])

    def add(piece: props.Props, first_material: int) -> None:
        faces.append(piece.faces + sum(map(len, pieces)))
        pieces.append(piece.vertices.astype(np.float32))
        normal_pieces.append(piece.normals)
        material.append(piece.material + np.uint8(first_material))

    if room.backdrop:
        board = props.board(float(solid.mesh.vertices[:, 2].min()) - BACKDROP_GAP_MM)
        middle = 0.5 * (solid.mesh.vertices.min(axis=0) + solid.mesh.vertices.max(axis=0)) * np.array([1.0, 1.0, 0.0])
        at = rig_from_solid.apply(board.vertices + middle)
        turned = rig_from_solid.rotate(board.normals)
        add(props.Props(vertices=at, normals=turned, faces=board.faces, material=board.material), 1)
    moving = [np.ones(len(placed), dtype=bool), np.zeros(len(pieces[-1]) if room.backdrop else 0, dtype=bool)]
    plain = [np.zeros(len(vertices), dtype=np.float32) for vertices in pieces[1:]]
    bent: list[int] = []  # materials of curved objects
    for thing in room.things:
        if thing.curved:
            bent += range(1 + len(colours), 1 + len(colours) + len(thing.colours))
        add(thing.props, 1 + len(colours))
        colours = np.concatenate([colours, thing.colours])
        count = len(thing.props.vertices)
        moving.append(np.full(count, thing.moves))
        plain.append(np.full(count, thing.smooth, dtype=np.float32))
    vertices, all_normals = np.concatenate(pieces), np.concatenate(normal_pieces)
    hidden = np.concatenate([hidden, np.zeros(len(vertices) - len(hidden), dtype=bool)])
    rays = _traced(vertices, np.concatenate(faces))
    seen = _visibility(rays, vertices.astype(np.float64), all_normals, lights, hidden)
    scattered = np.zeros((len(vertices), 3))
    if any(skin.scatter_mm):
        scattered[: len(placed)] = _scattered(body, normals, lights, seen[: len(placed), 1:], skin)
    seen[len(vertices) - sum(len(thing.props.vertices) for thing in room.things) :, 0] += np.concatenate(
        [np.zeros(0), *(np.full(len(thing.props.vertices), thing.glow) for thing in room.things)]
    )
    areola = np.concatenate([solid.areola, *plain])
    attributes = [np.column_stack([all_normals, areola, seen[:, 0], scattered, seen[:, 1:]])]

    lines = np.zeros((0, 1, 3), dtype=np.float32)
    if skin.hair_per_cm2:
        front = np.flatnonzero(~hidden[solid.mesh.faces].any(axis=1))
        lines, roots = props.strands(body, normals, front, skin.hair_per_cm2, seed)
        hair = props.tubes(lines)
        add(hair, 2)
        root = np.repeat(roots, len(hair.vertices) // len(lines))
        moving.append(np.ones(len(root), dtype=bool))
        attributes.append(np.column_stack([hair.normals, np.zeros((len(root), 5)), seen[root, 1:]]))
        attributes[-1][:, 4] = seen[root, 0]
    if room.clutter:
        boxes, box_colours = props.room(seed)
        add(boxes, 1 + len(colours))
        colours = np.concatenate([colours, box_colours])
        moving.append(np.zeros(len(boxes.vertices), dtype=bool))
        shaded = np.zeros((len(boxes.vertices), LIGHTS + len(lights)))
        shaded[:, :3] = boxes.normals
        shaded[:, 4] = _ROOM_LIGHT * (0.6 + 0.4 * boxes.normals[:, 1])
        attributes.append(shaded)
    vertices, all_faces = np.concatenate(pieces), np.concatenate(faces).astype(np.int32)
    looks = np.concatenate(attributes).astype(np.float32)
    if solid.tint is not None:
        tint = np.ones((len(vertices), 3), dtype=np.float32)
        tint[: len(placed)] = solid.tint
        looks = np.concatenate([looks, tint], axis=1)
    return StudioScene(
        mesh=TriangleMesh(vertices=vertices.astype(np.float64), faces=all_faces),
        subject_faces=len(solid.mesh.faces),
        subject_vertices=len(placed),
        vertices=vertices,
        painted=vertices,
        moves=np.concatenate(moving),
        attributes=looks,
        material=np.concatenate(material),
        piece=_pieces(all_faces, np.concatenate(material), np.concatenate(normal_pieces), len(solid.mesh.faces), bent),
        plain_colours=colours,
        strands=lines,
        lights=lights,
        rays=rays if len(attributes) == 1 else _traced(vertices, all_faces),
    )


def moved(scene: StudioScene, motion: SubjectMotion, seconds: float) -> StudioScene:
    """The scene at another time, with its colours and light moved along.

    The light is not computed again, because within some millimetres flashes and shadows do not change.
    """
    placed = scene.painted.astype(np.float64)
    placed[scene.moves] = motion.at(placed[scene.moves], seconds)
    vertices = placed.astype(np.float32)
    strands = scene.strands
    if len(strands):
        at = motion.at(strands.reshape(-1, 3).astype(np.float64), seconds)
        strands = at.reshape(strands.shape).astype(np.float32)
    return replace(
        scene,
        mesh=TriangleMesh(vertices=vertices.astype(np.float64), faces=scene.mesh.faces),
        vertices=vertices,
        strands=strands,
        rays=_traced(vertices, scene.mesh.faces),
    )


def _pieces(
    faces: Int32[Array, "m 3"],
    material: UInt8[Array, " m"],
    normals: Float64[Array, "n 3"],
    subject_faces: int,
    bent: Sequence[int],
) -> Int32[Array, " m"]:
    """Smooth piece of each face: one per material and direction, or one per curved material."""
    piece = np.zeros(len(faces), dtype=np.int32)
    props_faces = faces[subject_faces:]
    curved = np.isin(material[subject_faces:], bent)
    directions = np.where(curved[:, None], 0.0, np.round(normals[props_faces[:, 0]], 4))
    look = np.column_stack([material[subject_faces:], directions])
    piece[subject_faces:] = 1 + np.unique(look, axis=0, return_inverse=True)[1].ravel()
    return piece


def _traced(vertices: Float32[Array, "n 3"], faces: Array) -> EmbreeScene:
    rays = EmbreeScene()
    EmbreeMesh(rays, vertices, faces.astype(np.int32))
    return rays


def _scattered(
    mesh: TriangleMesh,
    normals: Float64[Array, "n 3"],
    lights: Float64[Array, "l 4"],
    seen: Float32[Array, "n l"],
    skin: SkinReflectance,
) -> Float64[Array, "n 3"]:
    """Change of irradiance at each vertex due to light below the surface, RGB.

    Diffusion along the mesh, in steps that halve the difference from the neighbours' mean. Each step adds a quarter of
    the mean square length of the edges to the variance along each axis of the surface.
    """
    towards = lights[:, :3] - mesh.vertices[:, None]
    distance = np.linalg.norm(towards, axis=2)
    cosine = (towards * normals[:, None]).sum(axis=2) / distance
    direct = (seen * lights[:, 3] * np.maximum(0.0, (cosine + skin.wrap) / (1.0 + skin.wrap)) / distance**2).sum(axis=1)
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    square_mm2 = float(((mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]]) ** 2).sum(axis=1).mean())
    count = len(mesh.vertices)
    near = csr_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    number = np.maximum(np.bincount(edges[:, 0], minlength=count), 1.0)
    gained = np.zeros((count, 3))
    done, soft = 0, direct.copy()
    for channel in np.argsort(skin.scatter_mm):
        steps = round(skin.scatter_mm[channel] ** 2 / (0.25 * square_mm2))
        for _ in range(steps - done):
            soft = 0.5 * (soft + near @ soft / number)
        done = max(done, steps)
        gained[:, channel] = soft - direct
    return gained


def _smooth_normals(solid: SubjectSolid, rig_from_solid: Transform) -> Float64[Array, "n 3"]:
    """Normals for shading. The rim has the front's normals, because that side is visible."""
    mesh = solid.mesh
    normals = mesh.vertex_normals()
    if solid.back_vertices:
        first = len(mesh.vertices) - solid.back_vertices
        front = mesh.faces[(mesh.faces < first).all(axis=1)]
        normals[:first] = TriangleMesh(vertices=mesh.vertices[:first], faces=front).vertex_normals()
    return rig_from_solid.rotate(normals)


def _visibility(
    rays: EmbreeScene,
    vertices: Float64[Array, "n 3"],
    normals: Float64[Array, "n 3"],
    lights: Float64[Array, "l 4"],
    hidden: Array,
) -> Float32[Array, "n s"]:
    """Visible share of the surroundings, then of each light's disc, at every vertex."""
    seen = np.zeros((len(vertices), 1 + len(lights)), dtype=np.float32)
    shown = np.flatnonzero(~hidden)
    origins = (vertices + _LIFT_MM * normals)[shown].astype(np.float32)
    sky = even_directions(2 * _SKY_SAMPLES)
    weight = np.zeros(len(shown))
    open_sky = np.zeros(len(shown))
    for direction in sky:
        cosine = normals[shown] @ direction
        ahead = np.flatnonzero(cosine > 0)
        free = _free(rays, origins[ahead], np.broadcast_to(direction.astype(np.float32), (len(ahead), 3)))
        weight[ahead] += cosine[ahead]
        open_sky[ahead] += cosine[ahead] * free
    seen[shown, 0] = open_sky / np.maximum(weight, 1e-9)
    for k, light in enumerate(lights):
        for target in _soft_box(light[:3]):
            towards = target - vertices[shown]
            ahead = np.flatnonzero(np.einsum("ij,ij->i", towards, normals[shown]) > -0.1 * np.linalg.norm(target))
            free = _free(rays, origins[ahead], towards[ahead].astype(np.float32))
            seen[shown[ahead], 1 + k] += free.astype(np.float32) / _SOFT_BOX_SAMPLES
    return seen


def _free(rays: EmbreeScene, origins: Array, directions: Array) -> Array:
    """Whether each ray is unobstructed."""
    if not len(origins):
        return np.zeros(0, dtype=bool)
    return rays.run(origins, np.ascontiguousarray(directions), query="OCCLUDED") == -1


def _soft_box(position: Float64[Array, 3]) -> Float64[Array, "s 3"]:
    """Points on a flash's disc, which faces the rig's centre."""
    axis = position / np.linalg.norm(position)
    a = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.8 else [0.0, 1.0, 0.0])
    a /= np.linalg.norm(a)
    b = np.cross(axis, a)
    angle = (np.arange(_SOFT_BOX_SAMPLES) + 0.5) * (2 * math.pi / _SOFT_BOX_SAMPLES)
    return position + SOFT_BOX_RADIUS_MM * math.sqrt(0.5) * (np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * b)
