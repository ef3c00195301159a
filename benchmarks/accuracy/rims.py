"""Distance of a rounded rim's visible edge in front of a cast's true base.

    python -m benchmarks.accuracy.rims --scale 0.25 --radii 0 0.15 0.3 0.5 0.8

Photographs domes of 116 × 125 × 48 mm on a dark board, with the reference rig, which end in rims of several radii,
and fits their bases to the silhouettes as the product does. Cameras and skin are the true ones (of the skin only what
lies clear of the rim), so that nothing but the rim is judged.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.matching.foreground.foreground import Foreground, blocks_of, estimate_foreground, subject_blocks
from mammometry.measure.boundary.boundary import find_base
from mammometry.measure.boundary.cast_rim import mean_height, rim_candidates
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.render import render_subject
from mammometry.simulate.rendering.scene import Room, StudioScene, light_scene
from mammometry.simulate.rendering.skin import SkinReflectance
from mammometry.simulate.rigs.build import build_rig, flashes
from mammometry.simulate.rigs.rig_file import find_plan
from mammometry.simulate.subjects.solid import SubjectSolid, rig_from_solid, rounded_mesh
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_RADIUS_MM, _HEIGHT_MM, _STRETCH = 58.0, 48.0, 1.08
_AROUND, _BACK_RINGS, _ARC_STEPS = 720, 58, 12
_SKIN_ROWS, _FINE_ROWS_MM = 160, (0.6, 0.3, 0.15, 0.08, 0.04, 0.02)
_BEHIND_MM = 4.0
_CLEAR_PX = 5.0
_SEED = 3


def dome(rim_radius_mm: float) -> SubjectSolid:
    """Half an ellipsoid on a plane, its edge rounded by a radius, mm."""
    turn = np.linspace(0, np.pi / 2, _SKIN_ROWS)
    wall_mm = _RADIUS_MM * np.sqrt(1 - (rim_radius_mm / _HEIGHT_MM) ** 2)
    if rim_radius_mm > 0:
        arc = np.linspace(0, np.pi / 2, _ARC_STEPS + 1)
        x_end = wall_mm - rim_radius_mm * (1 - np.cos(arc))
        z_end = rim_radius_mm * (1 - np.sin(arc))
    else:
        z_end = np.array([*_FINE_ROWS_MM, 0.0])
        x_end = _RADIUS_MM * np.sqrt(1 - (z_end / _HEIGHT_MM) ** 2)
    above = _HEIGHT_MM * np.cos(turn[1:]) > z_end[0] + 0.05
    inwards = np.linspace(1, 0, _BACK_RINGS + 2)[1:-1]
    x = np.concatenate([_RADIUS_MM * np.sin(turn[1:])[above], x_end, x_end[-1] * inwards])
    z = np.concatenate([_HEIGHT_MM * np.cos(turn[1:])[above], z_end, 0 * inwards])
    mesh = _revolved(x, z)
    angle = np.arange(_AROUND) * 2 * np.pi / _AROUND
    corner = wall_mm * np.stack([np.cos(angle), _STRETCH * np.sin(angle), 0 * angle], axis=1)
    return SubjectSolid(
        name="dome",
        subject_kind="model",
        mesh=rounded_mesh(mesh.vertices, mesh.faces),
        back_vertices=_BACK_RINGS * _AROUND + 1,
        areola=np.zeros(len(mesh.vertices), dtype=np.float32),
        base_boundary=corner,
        facts={"back": "flat"},
    )


def _revolved(x: Float64[Array, " k"], z: Float64[Array, " k"]) -> TriangleMesh:
    """The body of a profile from its top, which lies on the axis, to its back's middle."""
    angle = np.arange(_AROUND) * 2 * np.pi / _AROUND
    rings = np.stack(
        [np.outer(x, np.cos(angle)), _STRETCH * np.outer(x, np.sin(angle)), np.repeat(z[:, None], _AROUND, axis=1)],
        axis=2,
    ).reshape(-1, 3)
    k, after = np.arange(_AROUND), (np.arange(_AROUND) + 1) % _AROUND
    start = 1 + _AROUND * np.arange(len(x) - 1)[:, None]
    end = len(rings) + 1
    faces = [
        np.stack([0 * k, 1 + k, 1 + after], axis=1),
        np.stack([start + k, start + _AROUND + k, start + _AROUND + after], axis=2).reshape(-1, 3),
        np.stack([start + k, start + _AROUND + after, start + after], axis=2).reshape(-1, 3),
        np.stack([end - _AROUND + k, np.full(_AROUND, end), end - _AROUND + after], axis=1),
    ]
    vertices = np.concatenate([[[0.0, 0.0, _HEIGHT_MM]], rings, [[0.0, 0.0, 0.0]]])
    return TriangleMesh(vertices=vertices, faces=np.concatenate(faces).astype(np.int32))


def height_mm(rim_radius_mm: float, scale: float) -> float:
    """Mean height of the visible rim over a cast's true base, mm."""
    solid, plan = dome(rim_radius_mm), find_plan("reference")[0]
    rig, place = build_rig(plan, scale, _SEED), rig_from_solid(solid, _SEED)
    scene = light_scene(solid, place, flashes(plan=plan), Room(backdrop=True), seed=_SEED)
    silhouettes = {seen.camera: seen for seen in _silhouettes(scene, rig)}
    local = solid.mesh.vertices
    pixel_mm = np.median([np.linalg.norm(c.centre_world) / c.matrix[0, 0] for c in rig.cameras.values()])
    clear = local[:, 2] > rim_radius_mm + _CLEAR_PX * pixel_mm
    behind = local - np.where(local[:, 2:] <= rim_radius_mm / 2, [[0.0, 0.0, _BEHIND_MM]], 0.0)
    skin = RepairedSurface(
        mesh=TriangleMesh(vertices=place.apply(behind), faces=solid.mesh.faces),
        provenance=np.where(clear, Provenance.MEASURED, Provenance.INVENTED).astype(np.uint8),
        sigma_mm=np.full(len(local), 0.05, dtype=np.float32),
        pair_bits=clear.astype(np.int32),
        pair_names=tuple(rig.pair_names),
        convergence=np.zeros(1),
    )
    viewer = -np.mean([camera.axis_world for camera in rig.cameras.values()], axis=0)
    found, _ = find_base(rim_candidates(skin, silhouettes, rig), skin.mesh.vertices[clear], viewer)
    assert solid.base_boundary is not None
    return -mean_height(found.base, place.apply(solid.base_boundary))


def _silhouettes(scene: StudioScene, rig: Rig) -> Iterator[Foreground]:
    skin, film = SkinReflectance(), Film()
    for number, camera in enumerate(rig.cameras.values()):
        aperture = film.aperture(camera)
        light = render_subject(scene, camera, skin, seed=_SEED, aperture=aperture, background=film.stray_light)
        photograph = develop(light, film, name=camera.name, seed=_SEED + number)
        subject = subject_blocks(camera.name, blocks_of(photograph), ())
        yield estimate_foreground(photograph, camera.name, subject=subject)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", type=float, default=0.25, help="of the reference rig's pictures")
    parser.add_argument("--radii", type=float, nargs="+", default=[0.0, 0.15, 0.3, 0.5, 0.8], help="mm")
    arguments = parser.parse_args()
    print("| radius mm | base in front of the true one, mm |\n| --- | --- |")
    for radius in arguments.radii:
        print(f"| {radius:g} | {height_mm(radius, arguments.scale):+.3f} |", flush=True)


if __name__ == "__main__":
    main()
