"""Colours of vertices in every way that programs write them, and files that are hardly a scan."""

from pathlib import Path

import numpy as np
import pytest
from tests.mesh_contents import read_triangles
from tests.unit.measure.solids import dome

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MeasureError

SKIN = (204, 153, 128)
DOME = dome(sink_mm=10.0, rings=6, around=20)


def ply(kind: str, rgb: np.ndarray, *, of: str = "vertex", order: str = "ascii") -> bytes:
    """A PLY with a colour for each vertex or each face."""
    numpy_kind = {"uchar": "u1", "ushort": "<u2", "float": "<f4", "int": "<i4"}[kind]
    colour = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    head = f"ply\nformat {order} 1.0\nelement vertex {len(DOME.vertices)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + (colour if of == "vertex" else "")
    head += f"element face {len(DOME.faces)}\nproperty list uchar int vertex_indices\n"
    head += (colour if of == "face" else "") + "end_header\n"
    vertices = [tuple(row) for row in DOME.vertices.tolist()]
    faces = [(3, *row) for row in DOME.faces.tolist()]
    if order == "ascii":
        rows = {"vertex": vertices, "face": faces}
        written = np.asarray(rgb).astype(numpy_kind).tolist()
        rows[of] = [(*row, *values) for row, values in zip(rows[of], written, strict=True)]
        return (head + "\n".join(" ".join(map(str, row)) for row in rows["vertex"] + rows["face"])).encode()
    kinds = {"vertex": [("xyz", "<f4", 3)], "face": [("n", "u1"), ("corners", "<i4", 3)]}
    kinds[of].append(("rgb", numpy_kind, 3))
    points, corners = np.zeros(len(vertices), kinds["vertex"]), np.zeros(len(faces), kinds["face"])
    points["xyz"], corners["n"], corners["corners"] = DOME.vertices, 3, DOME.faces
    (points if of == "vertex" else corners)["rgb"] = rgb
    return head.encode() + points.tobytes() + corners.tobytes()


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("of", ["vertex", "face"])
@pytest.mark.parametrize(
    ("kind", "factor", "offset"),
    [("uchar", 1, 0), ("ushort", 257, 0), ("float", 1 / 255, 0), ("float", 1, 0), ("int", 1, 0), ("ushort", 1, 0)],
)
def test_every_kind_of_colour_is_the_same(
    tmp_path: Path, order: str, of: str, kind: str, factor: float, offset: float
) -> None:
    count = len(DOME.vertices if of == "vertex" else DOME.faces)
    rgb = np.tile(SKIN, (count, 1)) * factor + offset
    (tmp_path / "a.ply").write_bytes(ply(kind, rgb, of=of, order=order))
    colours = read_triangles(tmp_path / "a.ply")[2]
    assert np.abs(colours.astype(int) - SKIN).max() <= 1


@pytest.mark.parametrize("bright", [1.02, 1.4, 900.0, np.nan, np.inf])
def test_one_colour_above_all_does_not_make_the_others_black(tmp_path: Path, bright: float) -> None:
    rgb = np.tile(SKIN, (len(DOME.vertices), 1)) / 255
    rgb[7, 1] = bright
    (tmp_path / "a.ply").write_bytes(ply("float", rgb, order="binary_little_endian"))
    vertices, _, colours = read_triangles(tmp_path / "a.ply")
    place = (np.abs(vertices - DOME.vertices[7].astype(np.float32)) < 1e-3).all(axis=1)
    assert np.abs(colours[~place].astype(int) - SKIN).max() <= 1


@pytest.mark.parametrize("tail", ["0.8 0.6 0.5", "204 153 128", "0.8 0.6 0.5 1.0", "204 153 128 255"])
def test_an_obj_has_its_colours_behind_its_places(tmp_path: Path, tail: str) -> None:
    lines = [f"v {x} {y} {z} {tail}" for x, y, z in DOME.vertices.tolist()]
    lines += ["f " + " ".join(map(str, face)) for face in (DOME.faces + 1).tolist()]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    assert np.abs(read_triangles(tmp_path / "a.obj")[2].astype(int) - SKIN).max() <= 1


def test_faces_colours_blend_where_they_meet(tmp_path: Path) -> None:
    rgb = np.where((DOME.corners().mean(axis=1)[:, :1] > 0), (200, 0, 0), (0, 0, 200))
    (tmp_path / "a.ply").write_bytes(ply("uchar", rgb, of="face"))
    vertices, _, colours = read_triangles(tmp_path / "a.ply")
    assert (colours[vertices[:, 0] > 25] == (200, 0, 0)).all()
    assert (colours[vertices[:, 0] < -25] == (0, 0, 200)).all()


@pytest.mark.parametrize("count", [1, 2, 20])
def test_a_scan_of_a_few_triangles_is_refused_for_being_few(tmp_path: Path, count: int) -> None:
    lines = [f"v {x} {y} {z}" for x, y, z in (4 * DOME.vertices).tolist()]
    lines += ["f " + " ".join(map(str, face)) for face in (DOME.faces[:count] + 1).tolist()]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    with pytest.raises(MeasureError, match=rf"^mesh: .*{count} triangles?, .*\b50"):
        MeshJob(MeshFiles(mesh=tmp_path / "a.obj", units="mm", automatic=True), tmp_path / "out")
