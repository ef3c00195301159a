"""Models for the 3D viewer, from the products of a session.

They are simplified for viewing, and have every layer that can be drawn.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from mammometry.base.notices.words import NAMES
from mammometry.base.rounding import at_95
from mammometry.geometry import Array, Float64, Transform
from mammometry.geometry.mesh import TriangleMesh, joined
from mammometry.geometry.nearest import point_tree
from mammometry.measure.shape.lengths import LinearMeasure
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.figures.change import Dated
from mammometry.report.figures.measure import reach_mm
from mammometry.report.figures.shading import even_curve
from mammometry.report.figures.surface import PROVENANCE_COLOURS
from mammometry.report.scene import Layer, Texture, ViewedSurface, ViewerScene
from mammometry.surface.repair.repair import Provenance, RepairedSurface
from mammometry.surface.texture import simplify as thinning
from mammometry.surface.texture.texture import TexturedMesh
from mammometry.surface.texture.texture_atlas import Atlas
from mammometry.surface.texture.unmeasured import shown_colours

Seen = Callable[[Float64[Array, "n 3"]], Float64[Array, "n 3"]]
"""From the world frame to the viewing frame."""

_TEXTURE_PX = 2560  # longer side of the photographs on the 3D surface, px: limits the size of the page; appearance only
TRIANGLES = 200_000
"""Largest number of triangles of a model: more are not visible on a screen, and enlarge the page."""


def viewer_scene(
    frame: Float64[Array, "3 3"],
    repaired: RepairedSurface,
    textured: TexturedMesh,
    measurements: Sequence[VolumeMeasurement] = (),
    *,
    symmetry: Symmetry | None = None,
    atlas: Atlas | None = None,
    triangles: int = TRIANGLES,
) -> ViewerScene:
    """The whole surface with boundaries and walls, and both breasts for comparison.

    The right breast is mirrored.

    Args:
        frame: right, up and towards the viewer of the front view, as rows, world frame.
        repaired: the surface, world frame, mm.
        textured: the same mesh with its colours.
        measurements: one per breast.
        symmetry: aligns the mirrored right breast with the left one. Without it, the breast is only mirrored.
        atlas: the same surface, simplified and textured with its photographs at full resolution.
        triangles: largest number of triangles of the whole surface in the viewer.
    """
    centre = repaired.mesh.vertices.mean(axis=0)

    world_from_view = Transform(rotation=frame.T, translation_mm=centre)
    seen = world_from_view.inverse().apply

    surface = _ShownSurface(
        name="whole",
        title="Whole surface",
        repaired=repaired,
        textured=textured,
        measurements=measurements,
        atlas=atlas,
    )
    whole = _whole(surface, seen, triangles=triangles)
    models = [whole]
    sides = {measured.name: measured for measured in measurements}
    comparisons: tuple[tuple[str, str, str], ...] = ()
    if {"left", "right"} <= set(sides):
        both = sides["left"], sides["right"]
        models += [_breast(side, repaired, textured, seen, symmetry, triangles // 4) for side in both]
        comparisons = (("Left breast beside the mirrored right one", "left", "right"),)
    return ViewerScene(
        models=tuple(models),
        world_from_view=world_from_view,
        comparisons=comparisons,
        of_patient=not sides.keys().isdisjoint(("left", "right")),
    )


def change_scene(frame: Float64[Array, "3 3"], dates: tuple[Dated, Dated], limit_mm: float) -> ViewerScene:
    """One patient at two dates, side by side.

    The trunks are aligned. The later surface can be coloured by the change.

    Args:
        frame: rows right, up and towards the viewer of the front view, world frame of the earlier date.
        dates: the earlier one first.
        limit_mm: end of the change's colour scale in both directions.
    """
    centre = dates[0].repaired.mesh.vertices.mean(axis=0)
    world_from_view = Transform(rotation=frame.T, translation_mm=centre)
    view_from_world = world_from_view.inverse()
    models = []
    for date in dates:
        layers = () if date.change_mm is None else (_change_layer(date.change_mm, limit_mm),)
        models.append(
            _whole(
                _ShownSurface(
                    name=date.name,
                    title=date.title,
                    repaired=date.repaired,
                    textured=date.textured,
                    measurements=date.measurements,
                ),
                view_from_world.apply,
                own=date.world_from_own.apply,
                first=layers,
                triangles=TRIANGLES // 2,
            )
        )
    title = "Both dates side by side"
    return ViewerScene(
        models=tuple(models),
        world_from_view=world_from_view,
        comparisons=((title, dates[0].name, dates[1].name),),
        of_patient=True,
    )


def _change_layer(change_mm: Float64[Array, " n"], limit_mm: float) -> Layer:
    return Layer(
        name="change",
        title="Change between the dates",
        help=(
            "Distance of the later skin from the earlier one, with the trunks aligned: orange where it is in front, "
            "blue where it is behind; grey where the skin was not seen at both dates."
        ),
        values=change_mm.astype(np.float32),
        kind="diverging",
        unit="mm",
        limits=(-limit_mm, limit_mm),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _ShownSurface:
    """A whole surface from which a model is made."""

    name: str
    """Name in the program."""
    title: str
    """Name for the reader."""
    repaired: RepairedSurface
    """World frame."""
    textured: TexturedMesh
    """Its colours."""
    measurements: Sequence[VolumeMeasurement]
    """One per breast."""
    atlas: Atlas | None = None
    """The same surface textured with its photographs."""


def _whole(
    surface: _ShownSurface,
    seen: Seen,
    *,
    own: Seen = lambda points: points,
    first: tuple[Layer, ...] = (),
    triangles: int,
) -> ViewedSurface:
    """A whole surface with its layers, boundaries and walls.

    Args:
        surface: the surface.
        seen: world frame to viewing frame.
        own: from the frame of the measurements to the world frame.
        first: layers before those of every surface, one value per vertex.
        triangles: largest number of triangles.
    """
    repaired, atlas, measurements = surface.repaired, surface.atlas, surface.measurements
    mesh, origin = thinned(repaired.mesh, triangles) if atlas is None else _covered(atlas, repaired.mesh)
    walls = [measured.wall.mapped(own) for measured in measurements]
    moved = mesh.mapped(seen)
    return ViewedSurface(
        name=surface.name,
        title=surface.title,
        mesh=moved,
        normals=seen(repaired.mesh.vertex_normals()[origin]) - seen(np.zeros((1, 3))),
        colours=shown_colours(surface.textured.colours, repaired)[origin],
        texture=None if atlas is None else _texture(atlas),
        layers=(*(replace(layer, values=layer.values[origin]) for layer in first), *_layers(repaired, origin)),
        curves=tuple(
            (f"Boundary, {NAMES[measured.name]}", seen(even_curve(own(measured.boundary_world), repaired.mesh)), True)
            for measured in measurements
        ),
        wall=joined(walls).mapped(seen) if walls else None,
    )


def with_lengths(scene: ViewerScene, lengths: Sequence[LinearMeasure]) -> ViewerScene:
    """Draw lengths on the whole surface as lines with their values, with their ends as landmarks."""
    whole, *others = scene.models
    seen = scene.world_from_view.inverse().apply
    lines = tuple((_length_words(length), seen(np.array(length.ends_world))) for length in lengths)
    ends = {tuple(end.round(3)): end for _, both in lines for end in both}
    marked = replace(whole, lengths=lines, landmarks=tuple(("", end) for end in ends.values()))
    return replace(scene, models=(marked, *others))


def _length_words(length: LinearMeasure) -> str:
    """Label of a length's line: value and 95 % half-width. The length to the fold is along the skin."""
    if length.name.startswith("N-IMF") and length.geodesic_mm is not None:
        return f"{at_95(length.geodesic_mm, length.geodesic_sigma_mm, 'mm')} along the skin"
    return at_95(length.straight_mm, length.straight_sigma_mm, "mm")


def thinned(mesh: TriangleMesh, triangles: int) -> tuple[TriangleMesh, Array]:
    """Simplify a mesh by quadric edge collapse. Also returns the nearest original vertex of each vertex."""
    if len(mesh.faces) <= triangles:
        return mesh, np.arange(len(mesh.vertices))
    small = thinning.thinned(mesh, triangles)
    return small, _nearest(mesh, small)


def _covered(atlas: Atlas, mesh: TriangleMesh) -> tuple[TriangleMesh, Array]:
    """The atlas's mesh, and for each of its vertices the nearest vertex of the full mesh.

    The atlas's mesh has one vertex for each position in its texture.
    """
    origin, faces, _ = atlas.unwelded()
    return TriangleMesh(vertices=atlas.mesh.vertices[origin], faces=faces), _nearest(mesh, atlas.mesh)[origin]


def _texture(atlas: Atlas) -> Texture:
    """The atlas's picture, limited in size."""
    picture = Image.fromarray(atlas.picture)
    picture.thumbnail((_TEXTURE_PX, _TEXTURE_PX))
    buffer = io.BytesIO()
    picture.save(buffer, format="JPEG", quality=85)
    return Texture(uv=atlas.unwelded()[2].astype(np.float32), jpeg=buffer.getvalue())


def _nearest(of: TriangleMesh, to: TriangleMesh) -> Array:
    """For each vertex of `to`, the index of the nearest vertex of `of`."""
    return np.asarray(point_tree(of.vertices).query(to.vertices)[1])


def _layers(repaired: RepairedSurface, origin: Array) -> tuple[Layer, ...]:
    """Layers of the surface's origin and of its uncertainty."""
    sigma_mm = repaired.sigma_mm[origin]
    known = sigma_mm[np.isfinite(sigma_mm)]
    worst_mm = max(float(np.quantile(known, 0.98)) if len(known) else 0.0, 0.01)
    colours = [PROVENANCE_COLOURS[kind] for kind in sorted(Provenance)]
    return (
        Layer(
            name="provenance",
            title="Where it comes from",
            help=(
                "Measured parts were fitted to range data, repaired ones are next to them, bridged ones were closed "
                "between or beyond them, and invented ones were not seen by any pair of cameras."
            ),
            values=repaired.provenance[origin].astype(np.float32),
            kind="category",
            categories=tuple((meaning, colour) for colour, meaning in colours),
        ),
        Layer(
            name="error",
            title="Expected error",
            help="Expected standard deviation of the measured surface along its normal.",
            values=sigma_mm,
            kind="sequential",
            unit="mm",
            limits=(0.0, worst_mm),
        ),
    )


def _breast(
    measured: VolumeMeasurement,
    repaired: RepairedSurface,
    textured: TexturedMesh,
    seen: Seen,
    symmetry: Symmetry | None,
    triangles: int,
) -> ViewedSurface:
    """Skin and wall of one breast. The right breast is mirrored and aligned with the left one."""
    mirrored = measured.name == "right"
    skin, _ = thinned(measured.skin, triangles)
    origin = _nearest(repaired.mesh, skin)

    def placed(points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        if not mirrored:
            return seen(points_world)
        return seen(points_world) * (-1.0, 1.0, 1.0) if symmetry is None else seen(symmetry.mirrored(points_world))

    mesh, wall = skin.mapped(placed), measured.wall.mapped(placed)
    if mirrored:
        mesh, wall = mesh.turned_over(), wall.turned_over()
    name = NAMES[measured.name]
    return ViewedSurface(
        name=measured.name,
        title=f"{name[:1].upper()}{name[1:]}{', mirrored' if mirrored else ''}",
        mesh=mesh,
        normals=mesh.vertex_normals(),
        colours=shown_colours(textured.colours, repaired)[origin],
        layers=(*_layers(repaired, origin), *_symmetry_layer(symmetry, measured, skin)),
        curves=((f"Boundary, {name}", placed(even_curve(measured.boundary_world, skin)), True),),
        wall=wall,
    )


def _symmetry_layer(symmetry: Symmetry | None, measured: VolumeMeasurement, skin: TriangleMesh) -> tuple[Layer, ...]:
    """Distance of this breast from the other one, mirrored. Both breasts have the same scale."""
    if symmetry is None:
        return ()
    out_mm = symmetry.right_mm if measured.name == "right" else symmetry.left_mm
    limit_mm = reach_mm(symmetry)
    return (
        Layer(
            name="symmetry",
            title="Difference in shape",
            help=(
                "Distance of this breast from the other one, mirrored and aligned: orange where this one is fuller, "
                "blue where the other one is."
            ),
            values=out_mm[_nearest(measured.closed, skin)].astype(np.float32),
            kind="diverging",
            unit="mm",
            limits=(-limit_mm, limit_mm),
        ),
    )
