"""Pictures of meshes, by orthographic projection and Lambert shading.

This needs no window and no graphics card. The picture's plane goes through the view's centre, with coordinates in mm,
so scale bars, curves and sections are drawn in millimetres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float32, Float64, Int32, Int64, Rig, TriangleMesh, UInt8, bounds
from mammometry.geometry.curves import closed_length_mm, evenly_spaced
from mammometry.geometry.mesh_kernels import nearest_faces
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.trunk.body import BodyDirections, Mounting, camera_up
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.figures.shading_kernels import shaded

_LIGHTS = ((0.25, 0.45, 0.86, 0.72), (-0.75, 0.1, 0.65, 0.28), (0.1, -0.8, 0.6, 0.18))
"""Directions towards three lights (right, up, towards the viewer) and their strengths. Ambient light is added."""
_EVEN_MM = 6.0  # standard deviation along a curve with which it is smoothed for drawing; appearance only
_STRENGTHS = np.array(
    [strength / np.linalg.norm(towards) * np.array(towards) for *towards, strength in _LIGHTS], dtype=np.float32
)
"""Direction towards each light, times its strength."""
_AMBIENT = 0.16  # strength of the ambient light; appearance only
_FOOT = 0.09
"""Height of the strip for the scale bar, relative to that of the mesh."""
_PLASTER = (0.86, 0.84, 0.80)  # colour, red green blue, 0 to 1; appearance only


@value(eq=False)
class ViewDirection:
    """Viewing direction, scale and centre, without perspective."""

    name: str
    """Name of the view, such as "front"."""
    view_from_world: Float64[Array, "3 3"]
    """Proper rotation. Rows: the picture's right, its up, and the direction to the viewer, world frame."""
    centre_world: Float64[Array, 3]
    """The world point in the middle of the picture, mm."""
    span_mm: tuple[float, float]
    """Width and height of the visible area, mm."""

    def project(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Position to the right, upwards and towards the viewer, mm from the picture's centre."""
        return (points_world - self.centre_world) @ self.view_from_world.T

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge of the picture, mm from its centre."""
        width, height = self.span_mm
        return -width / 2, width / 2, -height / 2, height / 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VisibleFaces:
    """Faces and depths that are visible in a view, for each pixel."""

    faces: Int32[Array, "h w"]
    """Index of the visible face. −1 if there is none."""
    weights: Float32[Array, "h w 3"]
    """Barycentric weights of the face's corners at the pixel."""
    towards_mm: Float32[Array, "h w"]
    """Position towards the viewer, mm from the view's centre. −inf if there is no face."""

    @property
    def hit(self) -> Bool[Array, "h w"]:
        """Pixels that show a face."""
        return self.faces >= 0


class ShadedMesh:
    """A mesh that can be drawn in any number of views."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh
        self._casts: dict[tuple[ViewDirection, int], VisibleFaces] = {}

    @cached_property
    def normals(self) -> Float32[Array, "n 3"]:
        """Unit vertex normals."""
        return self.mesh.vertex_normals().astype(np.float32)

    def cast(self, view: ViewDirection, size_px: int) -> VisibleFaces:
        """Find the face visible at the centre of each pixel.

        The picture's longer side has `size_px` pixels. Results are cached, so that one view can be coloured in several
        ways.
        """
        key = view, size_px
        if key not in self._casts:
            self._casts[key] = self._cast(view, size_px)
        return self._casts[key]

    def _cast(self, view: ViewDirection, size_px: int) -> VisibleFaces:
        width, height = picture_wh(view, size_px)
        left_mm, right_mm, bottom_mm, top_mm = view.extent_mm
        corners = view.project(self.mesh.vertices)
        corners[:, 0] = (corners[:, 0] - left_mm) * (width / (right_mm - left_mm)) - 0.5
        corners[:, 1] = (top_mm - corners[:, 1]) * (height / (top_mm - bottom_mm)) - 0.5
        faces, weights, towards_mm = nearest_faces(corners, self.mesh.faces, height, width)
        return VisibleFaces(faces=faces, weights=weights, towards_mm=towards_mm)

    def render(
        self,
        view: ViewDirection,
        *,
        size_px: int = 600,
        colours: Float32[Array, "n 3"] | UInt8[Array, "n 3"] | None = None,
        face_colours: Float32[Array, "m 3"] | None = None,
        lit: bool | float = True,
    ) -> UInt8[Array, "h w 4"]:
        """Picture of the mesh, RGBA, transparent where there is none.

        Edges are smoothed with four samples per pixel.

        Args:
            view: the view.
            size_px: longer side of the picture, pixels.
            colours: colours of the vertices, sRGB-encoded, uint8 or 0…1; None: plaster.
            face_colours: colours of the faces instead, 0…1.
            lit: whether to shade, or how strongly, 0…1. Photographs on the surface already contain light and shade, and
                the colours of a map must not look like shadows.
        """
        cast = self.cast(view, 2 * size_px)
        by_face = colours is None or face_colours is not None
        given = colours if face_colours is None else face_colours
        if given is None:
            given = np.broadcast_to(np.array(_PLASTER, dtype=np.float32), (len(self.mesh.faces), 3))
        values = np.ascontiguousarray(given, dtype=np.float32) / np.float32(255 if given.dtype == np.uint8 else 1)
        normals = self.normals @ view.view_from_world.T.astype(np.float32)
        return shaded(
            cast.faces, cast.weights, self.mesh.faces, values, by_face, normals, float(lit), _STRENGTHS, _AMBIENT
        )


def picture_wh(view: ViewDirection, size_px: int) -> tuple[int, int]:
    """Even width and height of a picture with longer side `size_px`."""
    scale = size_px / max(view.span_mm)
    width, height = (max(2, 2 * round(span * scale / 2)) for span in view.span_mm)
    return width, height


def standard_views(
    mesh: TriangleMesh, frame: Float64[Array, "3 3"], *, of_patient: bool = False
) -> tuple[ViewDirection, ...]:
    """Four standard views: front, 45° from both sides, from below. All have the same scale and centre.

    Args:
        mesh: mesh to view.
        frame: rows right, up, towards the viewer of the front view, world frame: see `front_frame`.
        of_patient: whether sides are named as the patient's own: the left of the picture is the patient's right.
    """
    sides = np.sin(np.pi / 4), np.cos(np.pi / 4)
    left, right = ("patient's right", "patient's left") if of_patient else ("left", "right")
    turns = {
        "front": np.eye(3),
        f"45° from the {left}": np.array([[sides[1], 0, sides[0]], [0, 1, 0], [-sides[0], 0, sides[1]]]),
        f"45° from the {right}": np.array([[sides[1], 0, -sides[0]], [0, 1, 0], [sides[0], 0, sides[1]]]),
        "45° from below": np.array([[1, 0, 0], [0, sides[1], sides[0]], [0, -sides[0], sides[1]]]),
    }
    return views_of(mesh, {name: turn @ frame for name, turn in turns.items()})


def views_of(
    mesh: TriangleMesh, frames: dict[str, Float64[Array, "3 3"]], *, margin: float = 1.06
) -> tuple[ViewDirection, ...]:
    """Views of a mesh from given directions, at the same scale. Below each is a strip for the scale bar."""
    low, high = bounds(mesh.vertices)
    centre = (low + high) / 2
    placed = {}
    for name, frame in frames.items():
        seen = (mesh.vertices - centre) @ frame.T
        placed[name] = (seen.min(axis=0), seen.max(axis=0))
    width, height = (max(float(top[axis] - bottom[axis]) for bottom, top in placed.values()) for axis in (0, 1))
    foot = _FOOT * height
    span = max(width * margin, 1e-3), max(height * margin + foot, 1e-3)
    return tuple(
        ViewDirection(
            name=name,
            view_from_world=frame,
            centre_world=centre + ((placed[name][0] + placed[name][1]) / 2 * (1, 1, 0) - (0, foot / 2, 0)) @ frame,
            span_mm=span,
        )
        for name, frame in frames.items()
    )


def front_frame(
    rig: Rig, *, mounting: Mapping[str, Mounting] | None = None, patient_left_world: Float64[Array, 3] | None = None
) -> Float64[Array, "3 3"]:
    """Axes of the front view from the cameras, world frame.

    Rows: right, up and towards the viewer. The front is the cameras' mean direction, and up is the mean of their upward
    directions as mounted. If the direction to the patient's left is known, it becomes the picture's right. For a torso,
    the body's own axes (`measure.trunk.body`) are better.
    """
    axes = np.stack([camera.axis_world for camera in rig.cameras.values()])
    towards = -_unit(axes.mean(axis=0), fallback=axes[0])
    if patient_left_world is not None:
        right = _unit(patient_left_world - (patient_left_world @ towards) * towards, fallback=np.zeros(3))
        if right.any():
            return np.stack([right, np.cross(towards, right), towards])
    known = mounting or {}
    ups = np.stack([camera_up(camera, known.get(name, "upright")) for name, camera in rig.cameras.items()])
    mean = ups.mean(axis=0)
    up = _unit(mean - (mean @ towards) * towards, fallback=np.zeros(3))
    if not up.any():
        first = next(iter(rig.cameras.values())).camera_from_world.rotation
        up = _unit(np.cross(towards, first[0]), fallback=np.zeros(3))
    return np.stack([np.cross(up, towards), up, towards])


def front_of(rig: Rig, body: BodyDirections | None) -> Float64[Array, "3 3"]:
    """Axes of the front view: the body's own, or else the cameras'. Rows: right, up, towards the viewer.

    Args:
        rig: the cameras.
        body: directions of the patient's body; None for a cast.
    """
    return front_frame(rig) if body is None else body.frame


def section(
    mesh: TriangleMesh, point_world: Float64[Array, 3], normal_world: Float64[Array, 3]
) -> tuple[Float64[Array, "k 2 3"], Int64[Array, " k"]]:
    """Segments in which a plane cuts a mesh, world frame, mm, and the face of each."""
    heights = (mesh.vertices - point_world) @ normal_world
    above = (heights > 0)[mesh.faces]
    crossed = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    corners, sides = mesh.faces[crossed], above[crossed]
    # Each cut face has one corner alone on one side. The segment ends on the two edges at this corner.
    single_above = sides.sum(axis=1) == 1
    alone = np.argmax(np.where(single_above[:, None], sides, ~sides), axis=1)
    apex = corners[np.arange(len(corners)), alone]
    ends = []
    for step in (1, 2):
        other = corners[np.arange(len(corners)), (alone + step) % 3]
        share = heights[apex] / (heights[apex] - heights[other])
        ends.append(mesh.vertices[apex] + share[:, None] * (mesh.vertices[other] - mesh.vertices[apex]))
    return np.stack(ends, axis=1), crossed.astype(np.int64)


def visible(
    points_world: Float64[Array, "n 3"], view: ViewDirection, cast: VisibleFaces, *, slack_mm: float = 1.5
) -> Bool[Array, " n"]:
    """Mask of the points on or near the mesh that are visible in a view."""
    x, y, towards = view.project(points_world).T
    height, width = cast.faces.shape
    left_mm, right_mm, bottom_mm, top_mm = view.extent_mm
    column = np.clip(((x - left_mm) / (right_mm - left_mm) * width).astype(np.int64), 0, width - 1)
    row = np.clip(((top_mm - y) / (top_mm - bottom_mm) * height).astype(np.int64), 0, height - 1)
    seen: Bool[Array, " n"] = towards >= cast.towards_mm[row, column] - slack_mm
    return seen


def join_segments(segments: Float64[Array, "k 2 d"]) -> list[Float64[Array, "n d"]]:
    """Chain segments that share end points into polylines."""
    if not len(segments):
        return []
    keys, index = np.unique(np.round(segments.reshape(-1, segments.shape[2]), 6), axis=0, return_inverse=True)
    pairs = index.reshape(-1, 2)
    neighbours: dict[int, list[int]] = {}
    for a, b in pairs:
        if a != b:
            neighbours.setdefault(int(a), []).append(int(b))
            neighbours.setdefault(int(b), []).append(int(a))
    lines = []
    for start in sorted(neighbours, key=lambda node: len(neighbours[node]) != 1):
        while neighbours[start]:
            lines.append(keys[_walk(start, neighbours)])
    return lines


def _walk(start: int, neighbours: dict[int, list[int]]) -> Sequence[int]:
    path = [start]
    while neighbours[path[-1]]:
        here = path[-1]
        following = neighbours[here].pop()
        neighbours[following].remove(here)
        path.append(following)
    return path


def _unit(vector: Float64[Array, 3], *, fallback: Float64[Array, 3]) -> Float64[Array, 3]:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-6 else fallback


def even_curve(points_world: Float64[Array, "n 3"], mesh: TriangleMesh) -> Float64[Array, "m 3"]:
    """A closed curve for drawing: on the mesh, a point about every millimetre, smoothed along itself.

    Without this, noise of the skin and of the mesh's edges makes a boundary wave by 1 to 3 mm.
    """
    length_mm = closed_length_mm(points_world)
    count = min(max(int(length_mm), len(points_world)), 4000)
    dense = evenly_spaced(points_world, count)
    even = gaussian_filter1d(dense, _EVEN_MM * count / max(length_mm, 1e-9), axis=0, mode="wrap")
    return closest_on_mesh(even, mesh).points


def wall_faces(measured: VolumeMeasurement) -> Bool[Array, " m"]:
    """Faces of the closed solid that belong to its wall."""
    return np.arange(len(measured.closed.faces)) >= measured.skin_faces
