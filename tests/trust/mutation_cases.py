"""What is spoilt: small sessions, meshes, cameras and tables, each with the command that reads it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from benchmarks.accuracy.dates import grown, true_visit
from PIL import Image
from tests.brought.format_inputs import INPUTS
from tests.scenes.conftest import TINY, TINY_SETTINGS
from tests.unit.api.dated_session import put_results, write_session
from tests.unit.calibration import virtual_rig
from tests.unit.measure.solids import dome

from mammometry.base.progress import Progress
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.points import PointsTarget
from mammometry.cli import main, simulation
from mammometry.geometry.camera import Camera
from mammometry.io.cameras.formats import camera_texts
from mammometry.io.drift import CameraDrift, DriftEntry, append_history
from mammometry.job.products import STAGES
from mammometry.job.stages.report import previews_key
from mammometry.settings import Settings
from mammometry.simulate.subjects.torso_shape import torso_shape

_PAIR = ("front_left", "front_right")
_TABLES = """\
format = 1
units = "mm"
[rig]
name = "virtual"
pairs = [ {{ name = "front", left = "front_left", right = "front_right" }} ]
[target]
{target}
[subject]
kind = "model"
"""
_BOARD_TOLD = 'kind = "chessboard"\nsquares = [12, 9]\nsquare_mm = 25.0'
_EDGE_MM = 12.0
"""Of the torso's triangles: coarse, for nothing is measured on it."""
_AGREEMENT = "subject,water_cc,imaging_cc\n" + "".join(
    f"m{k},{300 + 13 * k + (k * 7) % 5}.5,{305 + 13 * k + (k * 3) % 7}.25\n" for k in range(9)
)


@dataclass(frozen=True)
class Case:
    """A command and the files that it reads."""

    name: str
    make: Callable[[Path], None]
    """Writes the folder, once."""
    arguments: tuple[str, ...]
    """Of the command; ``{here}`` is the folder."""
    spoilt: tuple[str, ...]
    """Patterns of the files that are spoilt, one of which is drawn first."""
    writes: tuple[str, ...] = ("results",)
    """What may be written or changed in the folder."""
    verdicts: tuple[int, ...] = ()
    """Exit codes that are an answer, not an error."""


def _dated(folder: Path, place: int = 2, date: str = "2026-03-01", growth: float = 1.0) -> None:
    """A torso that was measured, with all that can be drawn or brought beside it; everything is current."""
    visit = true_visit(grown(torso_shape("torso_2", 0), {"left": growth}), "torso_2", place, edge_mm=_EDGE_MM)
    marks = ("sternal_notch", "nipple_left", "nipple_right")
    skin = visit.torso.surface.mesh
    inwards = -skin.vertex_normals().mean(axis=0)
    back = replace(skin, vertices=skin.vertices + 60.0 * inwards / np.linalg.norm(inwards))  # a wall 60 mm behind it
    write_session(folder, visit, place, date=date, landmarks=marks, back=back)
    left, right = (folder / "capture" / f"{camera}.png" for camera in _PAIR)
    with Image.open(left) as image:
        image.save(left.with_suffix(".jpg"))
        (folder / "masks").mkdir()
        Image.new("L", image.size, 255).save(folder / "masks" / "front_right.png")
    with Image.open(right) as image:
        image.save(right.with_suffix(".tif"), compression="tiff_lzw")
    left.unlink()
    right.unlink()
    job = put_results(folder, visit)
    pictures = [previews_key(stage, job.plan) for stage in STAGES if stage != "report"]
    for key in (*(product.key for product in job.plan.products()), *pictures):
        if not job.store.has(key):  # what no command below reads
            job.store.write_folder(key, _standing_in(key.product))
    job.store.write_folder(job.report_key, _standing_in("report"))
    job.store.write_folder(job.content_key, _standing_in("content"))  # last: it tells how long the others took


def _standing_in(product: str) -> Callable[[], Callable[[Path, Progress], None]]:
    def write(folder: Path, progress: Progress) -> None:
        (folder / product).parent.mkdir(parents=True, exist_ok=True)
        (folder / product).with_suffix(".none").write_bytes(b"")

    return lambda: write


def _two_dates(folder: Path) -> None:
    _dated(folder / "before")
    _dated(folder / "after", 3, "2026-10-02", 1.3)


def _tables(target: ChessboardTarget | PointsTarget, description: str, poses: int) -> Callable[[Path], None]:
    """A session whose target's points lie in tables beside empty photographs: calibrated without any search."""

    def make(folder: Path) -> None:
        cameras = {name: camera for name, camera in virtual_rig.cameras_in_rig().items() if name.startswith("front")}
        seen = virtual_rig.observe(cameras, virtual_rig.placements(poses, target=target), target=target)
        for view in seen.detections:
            pose = folder / "calibration" / view.pose
            pose.mkdir(parents=True, exist_ok=True)
            Image.new("L", virtual_rig.SIZE_WH, 90).save(pose / f"{view.camera}.png")
            rows = [f"{number},{u!r},{v!r}" for number, (u, v) in zip(view.ids.tolist(), view.uv.tolist(), strict=True)]
            (pose / f"{view.camera}.csv").write_text("\n".join(["id,u,v", *rows]) + "\n")
        (folder / "session.toml").write_text(_TABLES.format(target=description))

    return make


def _solid_told() -> str:
    points = [list(point) for point in virtual_rig.solid_target().points_mm]
    return f'kind = "points"\npoints_mm = {json.dumps(points)}'


def _bare(folder: Path) -> None:
    """A session of two cameras without anything, to import cameras into."""
    (folder / "capture").mkdir(parents=True)
    (folder / "session.toml").write_text(_TABLES.format(target=_BOARD_TOLD))


def _cameras() -> dict[str, Camera]:
    return {name: camera for name, camera in virtual_rig.cameras_in_rig().items() if name.startswith("front")}


def _camera_files(form: Any) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        _bare(folder / "session")
        for name, text in camera_texts(_cameras(), form).items():
            (folder / name).write_text(text)

    return make


def _opencv_xml(folder: Path) -> None:
    _bare(folder / "session")
    for name, camera in _cameras().items():
        storage = cv2.FileStorage(str(folder / f"{name}.xml"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", camera.size_wh[0])
        storage.write("image_height", camera.size_wh[1])
        storage.write("camera_matrix", camera.matrix.copy())
        storage.write("distortion_coefficients", camera.distortion.copy())
        storage.write("R", camera.camera_from_world.rotation.copy())
        storage.write("T", camera.camera_from_world.translation_mm.copy())
        storage.release()


def _brought(name: str) -> Callable[[Path], None]:
    """Cameras of another program, as the search over formats has them."""

    def make(folder: Path) -> None:
        _bare(folder / "session")
        (subject,) = (subject for subject in INPUTS if subject.name == name)
        for file, content in subject.make().items():
            (folder / file).write_bytes(content)

    return make


def _mesh(suffix: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        folder.mkdir(parents=True)
        solid = dome(sink_mm=10.0, rings=12, around=48)
        scale = 0.001 if suffix == "glb" else 1.0
        trimesh.Trimesh(solid.vertices * scale, solid.faces, process=False).export(folder / f"mesh.{suffix}")
        angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
        rim = 60 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        table = {"units": "mm", "frame": "world", "boundaries": {"model": {"method": "drawn", "points": rim.tolist()}}}
        (folder / "boundaries.json").write_text(json.dumps(table))

    return make


def _with_back(folder: Path) -> None:
    """A scanned dome, with its back and its nipple."""
    _mesh("ply")(folder)
    plate = trimesh.creation.box((180.0, 180.0, 4.0)).subdivide().subdivide()
    plate.apply_translation((0.0, 0.0, -2.0))
    plate.export(folder / "back.stl")
    marks = {"units": "mm", "frame": "world", "landmarks": {"nipple_model": {"points": [[0.0, 0.0, 50.0]]}}}
    (folder / "landmarks.json").write_text(json.dumps(marks))


def _agreement(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "table.csv").write_text(_AGREEMENT)


def _settings(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "mine.toml").write_text(Settings().to_toml())


def _checked(folder: Path) -> None:
    """A rig that was checked before."""
    _bare(folder)
    for day in range(1, 4):
        drift = {
            name: CameraDrift(moved=day == 3, shift_mm=0.1 * day, turn_deg=0.01, shift_px=0.2, sigma=1.0 * day)
            for name in _PAIR
        }
        entry = DriftEntry(
            when=f"2026-04-0{day}T09:00:00+02:00",
            image_set="later",
            calibration="0" * 12,
            verdict="moved" if day == 3 else "unmoved",
            effect_mm=0.05 * day,
            reasons=("because",),
            cameras=drift,
        )
        append_history(folder, entry)


def _with_prior(folder: Path) -> None:
    """A session of points in tables whose lenses are known beforehand."""
    _tables(virtual_rig.BOARD, _BOARD_TOLD, 4)(folder)
    (folder / "prior.json").write_text(camera_texts(_cameras(), "json")["cameras.json"])


def _exposed_again(folder: Path) -> None:
    """A session of known cameras, and a later exposure of its target."""
    _tables(virtual_rig.BOARD, _BOARD_TOLD, 1)(folder)
    (folder / "cameras.json").write_text(camera_texts(_cameras(), "json")["cameras.json"])
    (folder / "calibration" / "00").rename(folder / "later")


def _rig(folder: Path) -> None:
    folder.mkdir(parents=True)
    shutil.copy(Path(__file__).resolve().parents[2] / "examples" / "rig.toml", folder)


def _finished(folder: Path) -> None:
    """The tiny demo with all its results."""
    (folder / "settings.toml").parent.mkdir(parents=True)
    (folder / "settings.toml").write_text(TINY_SETTINGS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "_DEMO_RECIPE", TINY)
        assert main.run(["demo", str(folder / "session"), "--settings", str(folder / "settings.toml"), "--quiet"]) == 0


_DRAWN = ("boundaries.json", "landmarks.json")
_RECORDS = "results/*/provenance.json"
_RESULTS = (_RECORDS, "results/surface/mesh.ply", "results/measure/*.npz", "results/measure/*.json")
_QUIET = ("--quiet",)


def _on_mesh(suffix: str) -> Case:
    arguments = (
        "measure",
        f"{{here}}/mesh.{suffix}",
        "--boundary",
        "{here}/boundaries.json",
        "--out",
        "{here}/results",
    )
    spoilt = (f"mesh.{suffix}",) * 3 + ("boundaries.json",)
    units = () if suffix == "glb" else ("--units", "mm")  # glTF is in metres
    return Case(f"mesh-{suffix}", _mesh(suffix), (*arguments, *units, *_QUIET), spoilt)


def _import(name: str, make: Callable[[Path], None], *files: str) -> Case:
    arguments = ("import-cameras", "{here}/session", *(f"{{here}}/{file}" for file in files), *_QUIET)
    spoilt = (*files, *files, "session/session.toml")
    return Case(f"import-{name}", make, arguments, spoilt, writes=("session/cameras.json", "session/.mammometry.json"))


_STAGES = ("session/results/*/provenance.json", "session/results/*/*.*", "session/results/*/*/*.*", "settings.toml")


def _finished_by(command: str, *arguments: str, spoilt: tuple[str, ...]) -> Case:
    writes = ("session/results", "session/evaluation", "session/.mammometry.json", "out")
    settings = ("--settings", "{here}/settings.toml")
    return Case(f"finished-{command}", _finished, (command, *arguments, *settings, *_QUIET), spoilt, writes)


_DATES = ("before", "after")
CASES: tuple[Case, ...] = (
    Case("info", _dated, ("info", "{here}", *_QUIET), ("session.toml", "cameras.json", *_DRAWN, "wall.ply", *_RESULTS)),
    Case("calibrate", _dated, ("calibrate", "{here}", *_QUIET), ("session.toml", "cameras.json", _RECORDS)),
    Case(
        "run", _dated, ("run", "{here}", *_QUIET),
        ("session.toml", "capture/*", "masks/*", *_DRAWN, "wall.ply", *_RESULTS),
    ),
    Case(
        "points", _tables(virtual_rig.solid_target(), _solid_told(), 2), ("calibrate", "{here}", *_QUIET),
        ("session.toml", "calibration/*/*.csv", "calibration/*/*.csv", "calibration/*/*.png"),
    ),
    Case("prior", _with_prior, ("calibrate", "{here}", *_QUIET), ("prior.json", "prior.json", "session.toml")),
    Case(
        "export", _dated, ("export-cameras", "{here}", "{here}/out", *_QUIET), ("cameras.json", "results/*/*.json"),
        writes=("results", "out"),
    ),
    Case(
        "history", _checked, ("check", "{here}", "--history", *_QUIET), ("checks/history.jsonl",),
        writes=("checks", "results"), verdicts=(10,),
    ),
    Case("verify", _dated, ("verify", "{here}", *_QUIET), ("results/*/*.*", _RECORDS), verdicts=(9,)),
    _on_mesh("ply"), _on_mesh("obj"), _on_mesh("stl"), _on_mesh("glb"),
    Case(
        "mesh-back", _with_back,
        ("measure", "{here}/mesh.ply", "--units", "mm", "--boundary", "{here}/boundaries.json", "--landmarks",
         "{here}/landmarks.json", "--wall", "{here}/back.stl", "--out", "{here}/results", *_QUIET),
        ("landmarks.json", "back.stl", "back.stl"),
    ),
    Case(
        "check", _exposed_again, ("check", "{here}", "--image-set", "{here}/later", *_QUIET),
        ("later/*", "later/*", "cameras.json"), writes=("checks", "results"), verdicts=(10,),
    ),
    _import("json", _camera_files("json"), "cameras.json"),
    _import("opencv", _camera_files("opencv"), *(f"{name}.yml" for name in _PAIR)),
    _import("opencv-xml", _opencv_xml, *(f"{name}.xml" for name in _PAIR)),
    _import("colmap", _camera_files("colmap"), "cameras.txt", "images.txt"),
    _import("kalibr", _camera_files("kalibr"), "camchain.yaml"),
    _import("agisoft", _brought("agisoft"), "cameras.xml"),
    _import("halcon", _brought("halcon"), *(f"{name}.cal" for name in _PAIR), "relpose.dat"),
    _import("matlab", _brought("matlab"), "rig.mat"),
    Case(
        "agreement", _agreement,
        ("study", "agreement", "{here}/table.csv", "--reference", "water_cc", "--measured", "imaging_cc", "--out",
         "{here}/results", *_QUIET),
        ("table.csv",),
    ),
    Case("settings", _settings, ("settings", "--settings", "{here}/mine.toml", *_QUIET), ("mine.toml",), writes=()),
    Case(
        "compare", _two_dates, ("compare", "{here}/before", "{here}/after", *_QUIET),
        tuple(f"{date}/{name}" for date in _DATES for name in ("session.toml", "cameras.json", *_DRAWN, *_RESULTS)),
        writes=("before/results", "after/results"),
    ),
    Case(
        "simulate", _rig,
        ("simulate", "{here}/out", "--rig", "{here}/rig.toml", "--subject", "sphere", "--scale", "0.02", "--poses", "1",
         *_QUIET),
        ("rig.toml",), writes=("out",),
    ),
    _finished_by("run", "{here}/session", spoilt=(*_STAGES, "session/results/*/*.png", "session/results/report/*")),
    _finished_by("report", "{here}/session", "--geometry-only", "--out", "{here}/out", spoilt=_STAGES),
    _finished_by("evaluate", "{here}/session", spoilt=("session/truth/*", "session/truth/*", *_STAGES)),
)  # fmt: skip


def prepared(case: Case, root: Path) -> Path:
    """The case's folder, made when it is first asked for; it is always called so, for a report tells its name."""
    name = next(one.name for one in CASES if one.make is case.make)
    if not (root / name).exists():
        shutil.rmtree(root / f".{name}", ignore_errors=True)
        case.make(root / f".{name}" / "case")
        (root / f".{name}").rename(root / name)
    return root / name / "case"
