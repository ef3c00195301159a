"""The page on how to extend the package is true: each of its blocks is run, and what it adds is then used."""

import __future__

import importlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from tests.unit.hospital.exports import exported
from tests.unit.job.planned_sessions import sessions
from tests.unit.matching.textured_pair import make_pair
from tests.unit.measure.solids import as_surface, ball, dome, rig_around
from tests.unit.report import synthetic

from mammometry.base.errors import SessionError
from mammometry.base.registry import Registry
from mammometry.calibration.detection.finders import find
from mammometry.calibration.features.pixels import FoundPoints
from mammometry.calibration.targets.table import target_from_table
from mammometry.calibration.targets.target import TARGETS
from mammometry.capture.camera import BACKENDS, Devices
from mammometry.capture.shots import PendingShot, take
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.io.cameras.formats import import_cameras
from mammometry.io.cameras.own import READERS
from mammometry.io.results.codecs import FORMATS
from mammometry.io.results.store import Store
from mammometry.job import method as method_page
from mammometry.job.graph import Plan
from mammometry.job.inputs import CameraSet, Inputs
from mammometry.job.products import Context, at_hand
from mammometry.job.stages import match, surface
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS
from mammometry.report.figures import stage_results
from mammometry.report.figures.canvas import CYCLE, caption_of
from mammometry.report.figures.catalogue import PAPER_FIGURES, PREVIEWS
from mammometry.report.figures.product_graph import product_graph
from mammometry.settings import Settings
from mammometry.simulate.disturbances.about import Surroundings
from mammometry.simulate.disturbances.registry import DISTURBANCES, check, disturbed
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.registry import RENDERERS
from mammometry.simulate.rendering.skin import SkinReflectance
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.poses import draw_poses
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.session import SimulatedSession, write_session
from mammometry.simulate.studio import Studio
from mammometry.simulate.subjects.registry import SUBJECTS, make_subject

REGISTRIES: tuple[Registry[Any], ...] = (
    TARGETS,
    TORSO_WALLS,
    CAST_WALLS,
    RENDERERS,
    SUBJECTS,
    DISTURBANCES,
    FORMATS,
    READERS,
    PREVIEWS,
    PAPER_FIGURES,
    BACKENDS,
)


_PLACED = re.compile(r"In a (?:new file|file of your own,) `([a-z_/]+\.py)`:\n\n```python\n(.*?)```", re.DOTALL)


def blocks(repository: Path) -> dict[str, dict[str, str]]:
    """Title of a section → its files' places in the package, with their content."""
    page = (repository / "docs" / "how-to" / "extend.md").read_text(encoding="utf-8")
    assert page.count("```python") == len(_PLACED.findall(page)), "a block without a file to put it into"
    sections = re.split(r"^## ", page, flags=re.MULTILINE)[1:]
    found = {each.partition("\n")[0]: dict(_PLACED.findall(each)) for each in sections}
    return {title: files for title, files in found.items() if files}


@pytest.fixture
def run(repository: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], dict[str, Any]]:
    """Run the files of a section, and give the names they define; what they add is taken away after the test.

    Where somebody has put such a file into the package, that one is meant.
    """
    for registry in REGISTRIES:
        assert len(registry)  # its modules are imported now, so that their entries stay
        monkeypatch.setattr(registry, "_entries", dict(registry._entries))

    def one(title: str) -> dict[str, Any]:
        defined: dict[str, Any] = {}
        for place, code in blocks(repository)[title].items():
            if (repository / "src" / "mammometry" / place).exists():
                name = f"mammometry.{place.removesuffix('.py').replace('/', '.')}"
                defined |= vars(importlib.import_module(name))
                continue
            module = ModuleType(f"extend: {place}")
            monkeypatch.setitem(sys.modules, module.__name__, module)  # where dataclasses look up their annotations
            exec(compile(code, f"extend.md: {place}", "exec"), vars(module))
            defined |= vars(module)
        return defined

    return one


@pytest.mark.slow
def test_what_is_pasted_as_told_keeps_the_house_rules(repository: Path, tmp_path: Path) -> None:
    """All files of the page in a copy of the repository, in which the checks of this folder then run."""
    copied = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=repository, capture_output=True)
    for name in copied.stdout.decode().split("\n"):
        if (repository / name).is_file():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(repository / name, tmp_path / name)
    for files in blocks(repository).values():
        for place, code in files.items():
            if "/" not in place:
                continue  # it stands outside the package
            (tmp_path / "src" / "mammometry" / place).write_text(code, encoding="utf-8")
    for words in (["init", "-q", "."], ["add", "-A"]):  # some checks look at what is to be committed
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/architecture", "-m", "not slow"]
    command += ["--deselect", "tests/architecture/test_session_page.py::test_every_key_of_every_target_is_on_the_page"]
    environment = os.environ | {"PYTHONPATH": f"{tmp_path / 'src'}{os.pathsep}{tmp_path}"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-6000:]


def test_a_calibration_target_is_described_drawn_and_found(run: Callable[[str], dict[str, Any]]) -> None:
    run("A calibration target")
    plain = target_from_table({"kind": "chessboard", "squares": [9, 6], "square_mm": 20.0})
    framed = target_from_table({"kind": "framed-chessboard", "squares": [9, 6], "square_mm": 20.0, "line_mm": 1.0})
    assert framed.kind == "framed-chessboard"
    sheet = framed.sheet()
    assert np.ptp(sheet.extent_mm, axis=0).tolist() == [200.0, 140.0]
    ink_mm2 = [np.prod(each.sheet().rectangles[:, 2:], axis=1).sum() for each in (plain, framed)]
    assert ink_mm2[1] - ink_mm2[0] == pytest.approx(2 * (200.0 + 140.0) * 1.0 - 4 * 1.0**2)

    rig, film = make_rig("reference:front", 0.2, 7), Film()
    (placed,) = draw_poses(rig, framed, 1, 7).values()
    camera = rig.cameras["front_left"]
    light = render_target(camera, placed, framed, flashes(), background=film.stray_light)
    found = find(framed, develop(light, film, name="board", seed=1), 900)
    assert isinstance(found, FoundPoints)
    assert len(found.ids) == 8 * 5
    true_uv = camera.project(placed.apply(framed.points_target))[found.ids]
    assert np.median(np.linalg.norm(found.uv - true_uv, axis=1)) < 0.1


def test_a_chest_wall_closes_a_breast(run: Callable[[str], dict[str, Any]]) -> None:
    run("A chest wall")
    settings = Settings().overridden(["measure.wall=shallow-bowl"])
    angle = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    rim = 60.0 * np.stack([np.cos(angle), np.sin(angle), np.zeros(180)], axis=1)
    boundary = Boundary(name="model", points_world=rim, method="drawn")
    cast = OpenBreast(boundary=boundary, surface=as_surface(dome()), settings=settings.measure)
    bowl, plane = (chest_wall.fit(cast, name) for name in (settings.measure.wall, "plane"))
    assert bowl.closed.is_watertight()
    # A bowl of radius R over a circle of radius a takes π a⁴ / (4 R); the dome's edge is cut a little inside its rim.
    a_mm = np.linalg.norm(cast.part.mesh.vertices[np.concatenate(cast.part.loops), :2], axis=1).mean()
    taken_cc = (plane.closed.volume_mm3() - bowl.closed.volume_mm3()) / 1000
    assert taken_cc == pytest.approx(np.pi * a_mm**4 / (4 * 300.0) / 1000, rel=0.01)


def test_a_matcher_takes_the_place_of_a_line(run: Callable[[str], dict[str, Any]]) -> None:
    matcher = run("A matcher")["block_matcher"]
    pair, true_px = make_pair(np.random.default_rng(1))
    found = matcher.function(pair, job=Context(inputs=NO_INPUTS, settings=Settings()))
    assert found.valid[pair.left_mask].mean() > 0.6
    assert np.median(np.abs(found.d_h_px - true_px)[found.valid]) < 0.25

    planned = sessions()["cast"]
    usual, other = (
        Plan(method_page.method, planned.inputs, planned.settings, None, given=given)
        for given in ({}, {match.disparity: matcher})
    )
    changed = {
        one.key.product for one, two in zip(usual.products(), other.products(), strict=True) if one.key != two.key
    }
    assert {"disparity/front", "range/front", "repaired", "measurement"} <= changed
    assert not changed & {"calibration", "cameras", "subjects", "foreground/back"}


def test_a_camera_file_is_read(run: Callable[[str], dict[str, Any]], tmp_path: Path) -> None:
    run("A camera format")
    rig = make_rig("reference:front", 0.2, 7)
    rows = tmp_path / "rig.rows"

    def row(camera: Camera) -> str:
        lens, pose = camera.matrix, camera.camera_from_world
        values = [*camera.size_wh, lens[0, 0], lens[0, 2], lens[1, 2], *camera.distortion]
        return " ".join(map(str, [camera.name, *values, *pose.rotation.ravel(), *pose.translation_mm]))

    rows.write_text("\n".join(map(row, rig.cameras.values())))
    read = import_cameras([rows], rig.pair_names)
    point = np.array([[10.0, -20.0, 30.0]])
    for name, camera in rig.cameras.items():
        assert read[name].project(point) == pytest.approx(camera.project(point), abs=5.0)  # one focal length of two
    rows.write_text("front_left 400 300 500")
    with pytest.raises(SessionError, match="line 1"):
        import_cameras([rows], rig.pair_names)


def test_numbers_are_exported_in_a_format_of_ones_own(run: Callable[[str], dict[str, Any]], tmp_path: Path) -> None:
    made = exported(tmp_path)
    lines = run("An export format")["plain_lines"](made).splitlines()
    assert len(lines) == len(made.quantities) > 2
    side, code, value, unit, low, high = lines[0].split("\t")
    assert (side, code, unit) == ("left", "volume", "cm3")
    assert float(low) < float(value) < float(high)


def test_a_camera_back_end_is_fired(run: Callable[[str], dict[str, Any]], tmp_path: Path) -> None:
    run("A camera back-end")
    names = ("a", "b", "c")
    rig = BACKENDS["grey-card"](Devices(cameras=names, ids={"a": "7"}, options={"dead": "c"}))
    taken = take(rig, names, PendingShot(tmp_path), timeout_s=1.0, features=False)
    assert set(taken.frames) == {"a", "b"}
    assert taken.frames["a"].serial == "7"
    assert taken.frames["a"].seen.median == pytest.approx(0.5, abs=0.02)
    assert "Plug it in" in str(taken.faults["c"])


def test_a_renderer_and_a_subject_make_a_session(run: Callable[[str], dict[str, Any]], tmp_path: Path) -> None:
    run("A renderer")
    run("A virtual subject")
    recipe = SessionRecipe(rig="reference:front", subject="egg", scale=0.03, poses=1)
    made: SimulatedSession = write_session(tmp_path / "out", recipe, Studio(renderer="silhouette", image_format="png"))
    assert made.true_volumes_cc["model"] == pytest.approx(4 / 3 * np.pi * 6.0**2 * 7.8, rel=0.01)
    from PIL import Image

    with Image.open(made.folder / "capture" / "front_left.png", formats=["PNG"]) as image:
        red = np.asarray(image)[..., 0]
    lit = red > 100
    assert lit.mean() > 0.02
    assert np.ptp(np.percentile(red[lit], [10, 90])) < 30  # evenly painted


@pytest.mark.slow
def test_a_figure_is_drawn_with_those_of_its_stage(run: Callable[[str], dict[str, Any]]) -> None:
    run("A figure")
    measurements = [synthetic.measurement("left", interval_cc=(440.0, 460.0)), synthetic.measurement("right")]
    result = synthetic.measured(synthetic.rig(), measurements, as_surface(ball(30.0, 3)).mesh)
    pictures = stage_results.draw(result)
    assert list(pictures).index("volumes") == max(list(pictures).index(name) for name in pictures)  # place 9: last
    assert caption_of(pictures["volumes"]).title == "The volumes"
    from PIL import Image

    with Image.open(io.BytesIO(pictures["volumes"]), formats=["PNG"]) as image:
        colours = np.asarray(image.convert("RGB")).reshape(-1, 3)
    for colour in CYCLE[:2]:  # a bar of some hundred pixels a breast
        wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)])
        assert (np.abs(colours.astype(int) - wanted).max(axis=1) < 3).sum() > 500
    assert "volumes" not in stage_results.draw(synthetic.measured(synthetic.rig(), [], result.textured.mesh))


def test_a_disturbance_is_put_beside_the_subject(run: Callable[[str], dict[str, Any]]) -> None:
    run("A disturbance of a virtual capture")
    solid = make_subject("sphere", 1, edge_mm=8.0)
    about = Surroundings(solid=solid, rig_from_solid=Transform.identity(), skin=SkinReflectance())
    (thing,) = disturbed(about, "thing", parse_situation("balloon=60"), 3).things
    assert np.ptp(thing.props.vertices[:, 1]) == pytest.approx(120.0)
    with pytest.raises(ValueError, match=r"balloon .* 20 and 200"):
        check(parse_situation("balloon=10"))


def test_a_product_is_made_once_kept_and_made_anew(run: Callable[[str], dict[str, Any]], tmp_path: Path) -> None:
    names = run("A stage product")

    def area(radius_mm: float) -> tuple[dict[str, float], list[str]]:
        first = at_hand(ball(radius_mm, 4), stage="surface", name="first", version=1, inputs={"radius": str(radius_mm)})
        memo = Store(tmp_path / "results")
        given = {surface.initial_surface: first}
        plan = Plan(names["with_area"], NO_INPUTS, Settings(), memo, stages=("surface",), given=given)
        return dict(plan[names["area"]]()), memo.made

    value, made = area(50.0)
    assert value["area_cm2"] == pytest.approx(4 * np.pi * 25.0, rel=0.01)
    assert made == ["surface/area"]
    assert json.loads((tmp_path / "results" / "surface" / "area.json").read_text())["area"] == value
    assert area(50.0) == (value, [])
    assert area(25.0)[0]["area_cm2"] == pytest.approx(value["area_cm2"] / 4)


NO_INPUTS = Inputs(
    rig_name="none", pair_names={}, subject_kind="torso", photographs={}, target=None, calibration_photographs={},
    digests={"subject": "torso"},
)  # fmt: skip


def test_a_product_is_a_function_and_a_line_of_the_method(
    repository: Path, run: object, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The walk of CONTRIBUTING.md, as if its function stood in the stage's file and its line in the method's."""
    page = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = page.partition("## Add a product to the surface stage")[2].partition("\n## ")[0]
    code, line = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    assert code.count("\n") < 30
    names = dict(vars(surface))
    exec(compile(code, "CONTRIBUTING.md", "exec", __future__.annotations.compiler_flag), names)
    monkeypatch.setattr(surface, "facing_area", names["facing_area"], raising=False)
    before, mesh, after = (
        Path(method_page.__file__).read_text(encoding="utf-8").partition("    mesh = plan(surface.mesh,")
    )
    longer = dict(vars(method_page))
    exec(compile(before + f"    {line.strip()}\n" + mesh + after, "method.py, with a line more", "exec"), longer)

    rig = rig_around()
    cameras = CameraSet(rig=rig, std={}, world="", rms_px=None)
    values: dict[Any, Any] = {surface.corrected_cameras: cameras, surface.repaired: as_surface(ball(50.0, 4))}
    given = {
        known: at_hand(value, stage="surface", name=known.name, version=1, inputs={}) for known, value in values.items()
    }
    memo = Store(tmp_path / "results")
    plan = Plan(longer["method"], NO_INPUTS, Settings(), memo, stages=("surface",), given=given)
    disc_cm2 = np.pi * 25.0
    assert plan[names["facing_area"]]() == pytest.approx(dict.fromkeys(rig.cameras, disc_cm2), rel=0.01)
    assert memo.state(plan[names["facing_area"]].key) == "current"
    assert "facing area" in product_graph(plan, {})


def test_every_block_of_the_page_is_run_by_a_test_above(repository: Path) -> None:
    source = Path(__file__).read_text(encoding="utf-8")
    assert set(re.findall(r'run\("([^"]+)"\)', source)) == set(blocks(repository))
    assert len(blocks(repository)) >= 5
