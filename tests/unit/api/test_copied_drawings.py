"""One curve in two files is a copy: persons do not agree to a thousandth of a millimetre."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.unit.measure.solids import dome

from mammometry.api.observers import measure_drawings, read_drawn_by
from mammometry.base.errors import SessionError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A dome, and a folder for curves on it."""
    solid = dome(sink_mm=10.0)
    trimesh.Trimesh(solid.vertices, solid.faces, process=False).export(tmp_path / "dome.ply")
    (tmp_path / "curves").mkdir()
    return tmp_path


def draw(folder: Path, name: str, radius_mm: float, decimals: int = 12, begin: int = 0) -> None:
    angles = np.roll(np.linspace(0, 2 * np.pi, 60, endpoint=False), begin)
    height_mm = (60**2 - radius_mm**2) ** 0.5 + 0 * angles
    rim = np.stack([radius_mm * np.cos(angles), radius_mm * np.sin(angles), height_mm], axis=1).round(decimals)
    table = {"boundaries": {"left": {"points": rim.tolist()}}}
    (folder / "curves" / name).write_text(json.dumps(table))


@pytest.mark.parametrize(
    ("other", "decimals", "begin"), [("ben-1.json", 12, 0), ("anna-2.json", 4, 0), ("ben.json", 12, 7)]
)
def test_a_copy_is_no_second_drawing(folder: Path, other: str, decimals: int, begin: int) -> None:
    draw(folder, "anna-1.json", 55.0)
    draw(folder, "cleo-1.json", 52.0)
    draw(folder, other, 55.0, decimals, begin)
    with pytest.raises(SessionError, match=r"\bleft .*\.json"):
        measure_drawings(read_drawn_by(folder / "curves", folder / "dome.ply"), units="mm", head="y", ahead="z")
