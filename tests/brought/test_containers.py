"""Every part of a GLB or USDZ that a reader may overlook is read right or refused by its name: no third outcome."""

import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from tests.brought.containers import GLBS, USDZS, VOLUME_CC, Container, Glb, random_glb

from mammometry.base.errors import SessionError
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.scans import ABOUT, ScanFacts, import_scan, read_scan


def require_right(container: Container, path: Path) -> None:
    path.write_bytes(container.make())
    if not container.volume_cc:
        with pytest.raises(SessionError) as refused:
            read_foreign(path)
        assert re.search(container.refused, str(refused.value)), str(refused.value)
        assert "cannot be read (" not in str(refused.value)  # it is whole
        return
    read = read_foreign(path)
    assert read.mesh.volume_mm3() / 1000 == pytest.approx(container.volume_cc, rel=1e-3)  # and not inside out
    assert read.mesh.is_watertight()
    assert [notice.code for notice in read.remarks] == [container.remark] * bool(container.remark)


@pytest.mark.parametrize("container", GLBS, ids=lambda container: container.name)
@pytest.mark.requirement("R-IN-15")
def test_a_glb_is_read_right_or_refused_by_name(tmp_path: Path, container: Container) -> None:
    require_right(container, tmp_path / "a.glb")


@pytest.mark.slow
@pytest.mark.parametrize(
    "container",
    [pytest.param(each, marks=[] if each.name in ("a proxy", "a PointInstancer") else pytest.mark.slow)
     for each in USDZS],
    ids=lambda container: container.name,
)  # fmt: skip
@pytest.mark.requirement("R-IN-15")
def test_a_usdz_is_read_right_or_refused_by_name(tmp_path: Path, container: Container) -> None:
    pytest.importorskip("pxr")
    require_right(container, tmp_path / "a.usdz")


def require_drawn_right(seed: int, folder: Path) -> str:
    """What is wrong with a file drawn by chance, or nothing."""
    content, volume_cc = random_glb(seed)
    path = folder / f"{seed}.glb"
    path.write_bytes(content)
    try:
        read_cc = read_foreign(path).mesh.volume_mm3() / 1000
    except SessionError as error:
        return "" if not volume_cc and "no triangles" in str(error) else f"{seed}: {error}"
    finally:
        path.unlink()
    return "" if read_cc == pytest.approx(volume_cc, rel=2e-3) else f"{seed}: {read_cc:.1f} cc for {volume_cc:.1f}"


@pytest.mark.requirement("R-IN-15")
def test_some_files_drawn_by_chance_have_their_volume(tmp_path: Path) -> None:
    wrong = list(filter(None, (require_drawn_right(seed, tmp_path) for seed in range(20))))
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
@pytest.mark.requirement("R-IN-15")
def test_a_thousand_files_drawn_by_chance_have_their_volume(tmp_path: Path) -> None:
    wrong = list(filter(None, (require_drawn_right(seed, tmp_path) for seed in range(20, 1020))))
    assert not wrong, "\n".join(wrong)


def test_the_search_covers_every_container_part() -> None:
    assert len(GLBS) >= 35
    assert len(USDZS) >= 20


def test_nodes_in_a_circle_and_joints_outside_the_scene_are_refused(tmp_path: Path) -> None:
    glb = Glb()
    inner = glb.node(mesh=glb.mesh(), children=[1])
    glb.node(children=[inner])
    (tmp_path / "a.glb").write_bytes(glb.content(1))
    with pytest.raises(SessionError, match="cycle"):
        read_foreign(tmp_path / "a.glb")


def test_one_mesh_placed_a_million_times_is_not_copied(tmp_path: Path) -> None:
    glb = Glb()
    extension = {"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": glb.accessor(np.ones((5000, 3)))}}}
    (tmp_path / "a.glb").write_bytes(glb.content(glb.node(mesh=glb.mesh(), extensions=extension)))
    with pytest.raises(SessionError, match=r"1280000 triangles .*\d+ bytes"):
        read_foreign(tmp_path / "a.glb")


def test_the_solids_volume_is_that_of_its_formula() -> None:
    assert pytest.approx(4 / 3 * np.pi * 0.6 * 0.4 * 0.8 * 1000, rel=0.08) == VOLUME_CC  # facets lie within the skin


def test_what_stands_behind_the_files_end_is_not_read(tmp_path: Path) -> None:
    content = GLBS[0].make()
    extra = json.dumps({"nodes": []}).encode()
    (tmp_path / "a.glb").write_bytes(content + struct.pack("<II", len(extra), 0x4E4F534A) + extra)
    assert read_foreign(tmp_path / "a.glb").mesh.volume_mm3() / 1000 == pytest.approx(VOLUME_CC, rel=1e-3)


def test_what_was_noted_of_a_container_is_kept_with_an_imported_scan(tmp_path: Path) -> None:
    mirrored = next(container for container in GLBS if container.name == "a negative scale")
    (tmp_path / "a.glb").write_bytes(mirrored.make())
    (tmp_path / ABOUT).write_bytes(import_scan(tmp_path / "a.glb", ScanFacts(scanner="A", units=""))[ABOUT])
    scan = read_scan(tmp_path)
    assert scan.units == "m, glTF's unit"
    assert [notice.code for notice in scan.notices] == ["mesh-part-mirrored"]
