"""Sessions of a virtual torso whose surfaces lie in the store as if photographs had been matched: no rendering."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.accuracy.dates import TrueVisit
from PIL import Image

from mammometry.api.job import Job, open_session
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.geometry.transform import Transform
from mammometry.io.cameras.own import cameras_table
from mammometry.io.drawn_changes import ItemChange, change_drawn, drawn_entry
from mammometry.job.inputs import FinishedSurface
from mammometry.job.stages import calibrate, measure
from mammometry.job.stages.surface import corrected_cameras, mesh
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.shape.anthropometry import dimensions, find_landmarks
from mammometry.measure.trunk.body import BodyDirections, find_body, rig_frame
from mammometry.measure.volume import volumes
from mammometry.measure.volume.uncertainty import VolumeEvidence
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.surface.texture.texture import TexturedMesh

MANIFEST = """\
format = 1
units = "mm"
{date}
[rig]
name = "two"
pairs = [ {{ name = "front", left = "front_left", right = "front_right" }} ]
[subject]
kind = "{kind}"
"""
SIZE_WH = (30, 20)


def rig() -> Rig:
    """One pair in front of the patient, upright, 900 mm away."""
    cameras = {}
    turn = np.diag([1.0, -1.0, -1.0])  # y down, looking along −z
    for name, x in (("front_left", -60.0), ("front_right", 60.0)):
        cameras[name] = Camera(
            name=name,
            size_wh=SIZE_WH,
            matrix=np.array([[40.0, 0, 15], [0, 40.0, 10], [0, 0, 1]]),
            distortion=np.zeros(5),
            camera_from_world=Transform(rotation=turn, translation_mm=-turn @ np.array([x, 0.0, 900.0])),
        )
    return Rig(name="two", cameras=cameras, pair_names={"front": ("front_left", "front_right")})


def write_session(
    folder: Path,
    true: TrueVisit,
    seed: int,
    *,
    date: str | None = None,
    kind: str = "torso",
    drawn: bool = True,
    landmarks: tuple[str, ...] = (),
    back: TriangleMesh | None = None,
) -> Path:
    """Write the manifest, cameras, and photographs of noise; boundaries and landmarks as somebody drew them."""
    (folder / "capture").mkdir(parents=True)
    rng = np.random.default_rng(seed)
    for camera in rig().cameras:
        noise = rng.integers(0, 255, (SIZE_WH[1], SIZE_WH[0], 3), dtype=np.uint8)
        Image.fromarray(noise).save(folder / "capture" / f"{camera}.png")
    (folder / "cameras.json").write_text(json.dumps(cameras_table(rig().cameras)))
    (folder / "session.toml").write_text(MANIFEST.format(kind=kind, date="" if date is None else f"date = {date}"))
    curves = {edge.name: edge.points_world for edge in true.torso.boundaries} if drawn else {}
    marks = {name: true.torso.solid.landmarks[name] for name in landmarks}
    if curves or marks:
        drawn = {("boundaries", name): points for name, points in curves.items()}
        drawn |= {("landmarks", name): points for name, points in marks.items()}
        entries = {item: drawn_entry(points, method="drawn", author="a test") for item, points in drawn.items()}
        change_drawn(folder, kind, {item: ItemChange(entry=entry, base=None) for item, entry in entries.items()})
    if back is not None:
        write_ply(folder / "wall.ply", back)
    return folder


def put_results(folder: Path, true: TrueVisit, boundaries: tuple[Boundary, ...] | None = None) -> Job:
    """Put what the stages would have made of the true skin into the session's store."""
    job = open_session(folder)
    plan, surface = job.plan, true.torso.surface
    colours = np.full((len(surface.mesh.vertices), 3), (205, 160, 140), dtype=np.uint8)
    finished = FinishedSurface(repaired=surface, textured=TexturedMesh(mesh=surface.mesh, colours=colours))
    method, remark = ("given: drawn", "given") if job.inputs.boundaries else ("automatic", "to-be-confirmed")
    edges = tuple(
        Boundary(name=edge.name, points_world=edge.points_world, method=method, remarks=(remark,))
        for edge in boundaries or true.torso.boundaries
    )
    settings, frame = job.settings.measure, rig_frame(rig())
    back = job.inputs.wall
    breasts = open_breasts(edges, surface, settings, frame=frame, back=back)
    evidence = VolumeEvidence(surface=surface)
    measured = tuple(
        volumes.measure(breast.boundary, chest_wall.fit(breast), settings, evidence=evidence) for breast in breasts
    )
    own = BodyDirections(frame=frame, point_world=np.zeros(3), plane_sigma_mm=None, scatter_mm=None)
    marks = find_landmarks(surface, colours, measured, job.inputs.landmarks, own, settings)
    sizes = dimensions(surface.mesh, measured, marks, frame, settings)
    for definition, value in (
        (mesh, finished),
        (corrected_cameras, plan[calibrate.cameras]()),
        (measure.boundaries, edges),
        (measure.body, find_body(surface, frame, boundaries=[edge.points_world for edge in edges])),
        (measure.measurements, measured),
        (measure.landmarks, marks),
        (measure.dimensions, sizes),
    ):
        job.store.recall(plan[definition].key, _holding(value))
    return job


def _holding(value: Any) -> Callable[[], Callable[[Any], Any]]:
    return lambda: lambda progress: value
