"""The covering picture on another mesh: places are those of the same points of the skin."""

import numpy as np
import pytest

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.texture.texture_atlas import Atlas, transferred


def sheet(step: float, tilt: float = 0.3) -> TriangleMesh:
    """A tilted plane of 60 × 60 mm."""
    ticks = np.arange(-30, 30 + step / 2, step)
    x, y = (each.ravel() for each in np.meshgrid(ticks, ticks))
    number = np.arange(len(ticks) ** 2, dtype=np.int32).reshape(len(ticks), -1)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    faces = np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))])
    return TriangleMesh(vertices=np.column_stack([x, y, tilt * x]), faces=faces)


def place(points: Float64[Array, "n 3"], chart: Array) -> Float64[Array, "n 2"]:
    """Two photographs of the plane: the second lies 400 pixels to the right in the picture, and is turned."""
    x, y = points[:, 0], points[:, 1]
    first = np.column_stack([100 + 3 * x + 0.5 * y, 120 - 3 * y])
    second = np.column_stack([500 - 3 * y, 120 - 3 * x])
    return np.where(np.asarray(chart)[:, None] == 0, first, second)


def covered(step: float, seam_x: float) -> Atlas:
    mesh = sheet(step)
    view = (mesh.corners().mean(axis=1)[:, 0] > seam_x).astype(np.int64)
    uv = np.stack([place(mesh.corners()[:, corner], view) for corner in range(3)], axis=1)
    picture = np.zeros((240, 700, 3), dtype=np.uint8)
    return Atlas(mesh=mesh, uv_px=uv.astype(np.float32), picture=picture, view=view, names=("a", "b"))


@pytest.mark.parametrize("step", [0.9, 2.3, 7.0])
def test_every_corner_has_the_place_of_its_point(step: float) -> None:
    """One photograph: no seam. The places are float32 of up to 500 pixels: 3e-5."""
    mesh = sheet(step)
    found = transferred(covered(4.0, seam_x=99.0), mesh)
    inside = np.abs(mesh.corners()[..., :2]).max(axis=(1, 2)) <= 30
    for corner in range(3):
        expected = place(mesh.corners()[inside, corner], np.zeros(int(inside.sum())))
        np.testing.assert_allclose(found.uv_px[inside, corner], expected, atol=1e-3)
    assert found.mesh is mesh


@pytest.mark.parametrize("seam_x", [-10.0, 2.0])
def test_no_face_reaches_from_one_photograph_into_another(seam_x: float) -> None:
    mesh = sheet(1.7)
    found = transferred(covered(4.0, seam_x), mesh)
    assert set(np.unique(found.view)) == {0, 1}
    for view in (0, 1):
        rows = found.view == view
        for corner in range(3):
            points = mesh.corners()[rows, corner]
            off = np.linalg.norm(found.uv_px[rows, corner] - place(points, np.full(len(points), view)), axis=1)
            assert off.max() < 1.7 * 3 * 1.2  # beyond the seam: less than a face's own size, 1.7 mm of 3 pixels
            assert np.mean(off > 1e-3) < 0.1


def test_a_mesh_a_little_beside_the_surface_keeps_its_places() -> None:
    """The viewing mesh is thinned: it lies some tenths of a millimetre beside the measured surface."""
    mesh = sheet(1.7)
    lifted = mesh.vertices + 0.3 * np.array([-0.3, 0, 1]) / np.hypot(0.3, 1)
    found = transferred(covered(4.0, seam_x=99.0), TriangleMesh(vertices=lifted, faces=mesh.faces))
    inner = np.abs(mesh.corners()[..., :2]).max(axis=(1, 2)) < 29
    on_plane = mesh.corners()[inner]
    for corner in range(3):
        expected = place(on_plane[:, corner], np.zeros(len(on_plane)))
        np.testing.assert_allclose(found.uv_px[inner, corner], expected, atol=1e-3)


def test_a_mesh_without_faces_is_refused() -> None:
    nothing = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int32))
    atlas = Atlas(
        mesh=nothing, uv_px=np.zeros((0, 3, 2), np.float32), picture=np.zeros((4, 4, 3), np.uint8),
        view=np.zeros(0, dtype=np.int64), names=(),
    )  # fmt: skip
    with pytest.raises(ValueError, match="faces"):
        transferred(atlas, sheet(10.0))
