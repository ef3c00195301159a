"""Physically based pictures by Mitsuba 3 (optional extra ``sim``).

Scene and lens are those of the built-in renderer. Mitsuba has no sensor with lens distortion, so it traces the built-in
renderer's rays through the scene (path tracing with interreflection, area lights, a microfacet sheen). The scalar
variant does not need the LLVM library. A picture at a quarter of the size takes about a minute.
"""

from __future__ import annotations

import importlib.util
import math
from functools import lru_cache
from threading import Lock
from typing import Any

import numpy as np

from mammometry.base.errors import SettingsError
from mammometry.geometry import Array, Camera, Float32, Float64, Int32, TriangleMesh
from mammometry.simulate.rendering.registry import add_renderer
from mammometry.simulate.rendering.render import AMBIENT, blocks, paint_seed, sample_rays
from mammometry.simulate.rendering.sampling import PINHOLE, Aperture
from mammometry.simulate.rendering.scene import LIGHTS, SOFT_BOX_RADIUS_MM, StudioScene
from mammometry.simulate.rendering.shading import paint_at
from mammometry.simulate.rendering.skin import SkinReflectance

_VARIANT = "scalar_rgb"
_BOUNCES = 4  # reflections of light between surfaces: skin of reflectance 0.6 keeps a tenth
_SAMPLES = 8  # samples per pixel and light; twice as many at edges
_PIXELS_AT_ONCE = 4096  # pixels traced at a time; limits memory
_LOCK = Lock()


def require_mitsuba() -> None:
    """Require Mitsuba.

    Raises:
        SettingsError: it is not installed.
    """
    if importlib.util.find_spec("mitsuba") is None:
        raise SettingsError(
            "--renderer mitsuba",
            found="no Mitsuba 3 in this installation",
            expected="the optional packages of the extra 'sim'",
            remedy="Run pip install 'mammometry[sim]', or use the built-in renderer",
        )


@add_renderer("mitsuba", require=require_mitsuba)
def render_by_mitsuba(
    scene: StudioScene,
    camera: Camera,
    skin: SkinReflectance,
    *,
    seed: int,
    aperture: Aperture = PINHOLE,
    background: float = 0.0,
) -> Float32[Array, "h w 3"]:
    """Radiance of the scene at the camera by path tracing, like `render.render_subject`.

    Args:
        scene: lit scene, rig frame. Only the positions and strengths of the flashes are used of its lighting.
        camera: camera in the rig's frame.
        skin: appearance of the subject.
        seed: seed of the mottling and of the paths.
        aperture: aperture of the lens.
        background: radiance of the dark room.

    Raises:
        SettingsError: Mitsuba is not installed.
    """
    require_mitsuba()
    import mitsuba as mi

    image = np.full((*camera.shape_hw, 3), background, dtype=np.float32)
    with _LOCK:  # the variant is global, and the work holds the GIL anyway
        mi.set_variant(_VARIANT)
        world = _world(scene, skin, seed)
        integrator, sampler = world.integrator(), mi.load_dict({"type": "independent"})
        sampler.seed(_stream(seed, camera))
        parameters = mi.traverse(world)
        emitters = [f"flash_{number}.emitter" for number in range(len(scene.lights))] + ["surroundings"]
        radiances = {name: np.array(parameters[f"{name}.radiance.value"]) for name in emitters}
        # One light at a time: choosing lights at random would cause most of the noise.
        for emitter in emitters:
            for name, radiance in radiances.items():
                parameters[f"{name}.sampling_weight"] = float(name == emitter)
                parameters[f"{name}.radiance.value"] = mi.Color3f(*(radiance * (name == emitter)).tolist())
            parameters.update()
            for block in blocks(scene, camera, aperture):
                row, column = block.row, block.column
                samples = 2 * _SAMPLES if block.is_edge else _SAMPLES
                for start in range(0, len(row), _PIXELS_AT_ONCE):
                    part = slice(start, start + _PIXELS_AT_ONCE)
                    origins, directions = sample_rays(camera, row[part], column[part], samples, aperture)
                    light = np.empty((len(origins), 3))
                    for k, (o, d) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
                        ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(*o), mi.Vector3f(*d)))
                        light[k] = integrator.sample(world, sampler, ray)[0]
                    image[row[part], column[part]] += light.reshape(-1, samples, 3).mean(axis=1)
        for name, radiance in radiances.items():
            parameters[f"{name}.radiance.value"] = mi.Color3f(*radiance.tolist())
        parameters.update()
    return image


@lru_cache(maxsize=1)
def _world(scene: StudioScene, skin: SkinReflectance, seed: int) -> Any:
    """The scene in Mitsuba's format."""
    import mitsuba as mi

    mi.set_variant(_VARIANT)
    alpha = math.sqrt(2.0 / (skin.exponent + 2.0))
    subject = {
        "type": "principled",
        "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
        "roughness": min(1.0, math.sqrt(math.hypot(alpha, skin.roughness))),
        "specular": min(1.0, skin.specular / 0.08),
        "flatness": 1.0 if any(skin.scatter_mm) else 0.0,
    }
    plain = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": subject["base_color"]}}
    described: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": _BOUNCES + 1, "hide_emitters": True},
        "surroundings": {"type": "constant", "radiance": {"type": "rgb", "value": [AMBIENT] * 3}},
    }
    area = math.pi * SOFT_BOX_RADIUS_MM**2
    for number, light in enumerate(scene.lights):
        position, strength = light[:3].tolist(), float(light[3])
        up = [0.0, 1.0, 0.0] if abs(position[1]) < 0.9 * math.hypot(*position) else [1.0, 0.0, 0.0]
        to_world = mi.ScalarTransform4f().look_at(origin=position, target=[0.0, 0.0, 0.0], up=up)
        described[f"flash_{number}"] = {
            "type": "disk",
            "to_world": to_world @ mi.ScalarTransform4f().scale(SOFT_BOX_RADIUS_MM),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [math.pi * strength / area] * 3}},
        }
    described["subject"] = _painted_subject(scene, skin, seed, mi.load_dict(subject))
    if len(scene.mesh.faces) > scene.subject_faces:
        faces = scene.mesh.faces[scene.subject_faces :]
        colours = np.zeros((len(scene.vertices), 3))
        colours[faces] = scene.plain_colours[scene.material[scene.subject_faces :].astype(np.int64) - 1][:, None]
        first = scene.subject_vertices
        described["props"] = _mesh(
            scene.vertices[first:], scene.attributes[first:, :3], faces - first, colours[first:], mi.load_dict(plain)
        )
    return mi.load_dict(described)


def _painted_subject(scene: StudioScene, skin: SkinReflectance, seed: int, bsdf: Any) -> Any:
    """The subject with each face divided into four, and with colours at its vertices."""
    mesh = TriangleMesh(
        vertices=scene.mesh.vertices[: scene.subject_vertices], faces=scene.mesh.faces[: scene.subject_faces]
    )
    looks = scene.attributes[: scene.subject_vertices]
    tint = looks[:, LIGHTS + len(scene.lights) :] if looks.shape[1] > LIGHTS + len(scene.lights) else np.ones((1, 3))
    values = np.column_stack(
        [
            mesh.vertices,
            looks[:, :4],
            scene.painted[: scene.subject_vertices].astype(np.float64),
            np.broadcast_to(tint, mesh.vertices.shape),
        ]
    )
    values, faces = _quartered(values, mesh.faces)
    # Details finer than the faces would alias.
    sides = values[faces[:, 0], :3] - values[faces[:, 1], :3]
    footprint_mm = 2.0 * float(np.sqrt((sides**2).sum(axis=1).mean()))
    colours = paint_at(
        np.ascontiguousarray(values[:, 7:10]),
        np.ascontiguousarray(values[:, 6]),
        footprint_mm,
        np.array([skin.base_rgb, skin.areola_rgb]),
        skin.spectrum(),
        skin.marks(),
        paint_seed(seed),
    )
    normals = values[:, 3:6] / np.maximum(np.linalg.norm(values[:, 3:6], axis=1, keepdims=True), 1e-9)
    return _mesh(values[:, :3], normals, faces, np.clip(colours * values[:, 10:13], 0.0, 0.95), bsdf)


def _quartered(values: Float64[Array, "n c"], faces: Int32[Array, "m 3"]) -> tuple[Array, Int32[Array, "k 3"]]:
    """Every face divided into four at the midpoints of its edges, with mean values there."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    once, which = np.unique(edges, axis=0, return_inverse=True)
    a, b, c = (len(values) + which.reshape(3, -1)).astype(np.int32)
    middles = 0.5 * (values[once[:, 0]] + values[once[:, 1]])
    v0, v1, v2 = faces.T
    cut = [np.stack(corner, axis=1) for corner in ((v0, a, c), (a, v1, b), (c, b, v2), (a, b, c))]
    return np.concatenate([values, middles]), np.concatenate(cut).astype(np.int32)


def _mesh(vertices: Array, normals: Array, faces: Array, colours: Array, bsdf: Any) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    properties["bsdf"] = bsdf
    mesh = mi.Mesh("mesh", len(vertices), len(faces), props=properties, has_vertex_normals=True)
    mesh.add_attribute("vertex_color", 3, colours.ravel().tolist())
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.asarray(vertices, dtype=np.float32).ravel()
    parameters["vertex_normals"] = np.asarray(normals, dtype=np.float32).ravel()
    parameters["faces"] = np.asarray(faces, dtype=np.uint32).ravel()
    parameters.update()
    return mesh


def _stream(seed: int, camera: Camera) -> int:
    """Number of the random stream of one picture."""
    return int(np.random.default_rng([seed, 91, *camera.name.encode()]).integers(1 << 31))
