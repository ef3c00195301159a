"""What is written is read back, and other programs can read it."""

import dataclasses
import importlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
import trimesh
from PIL import Image

from mammometry.base.errors import StorageError
from mammometry.base.notices import Notice
from mammometry.calibration.detection.detect import Detection, MissedView, Observations
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.io.results.codecs import STORED_FIELDS, STORED_TYPES, decode, encode, from_tree, to_tree, write_arrays
from mammometry.io.results.formats import read_raster, write_raster
from mammometry.job.inputs import CameraSet, FinishedSurface
from mammometry.matching.dense.match import DisparityMap
from mammometry.measure.boundary.boundary import Boundary
from mammometry.surface.ranges.dents import KeepMasks
from mammometry.surface.repair.repair import Provenance, RepairedSurface
from mammometry.surface.texture.texture import TexturedMesh
from mammometry.surface.texture.texture_atlas import Atlas, as_jpeg, jpeg_of

RNG = np.random.default_rng(3)
CONFIRM = ("to-be-confirmed",)


def camera(name: str = "left", size_wh: tuple[int, int] = (7, 5)) -> Camera:
    return Camera(
        name=name,
        size_wh=size_wh,
        matrix=np.array([[100.1, 0, 3], [0, 100.1, 2], [0, 0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=Transform.from_rotation_vector(np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])),
    )


def disparity_map() -> DisparityMap:
    pages = {name: RNG.random((5, 7), dtype=np.float32) for name in ("d_h_px", "d_v_px", "confidence", "sigma_px")}
    return DisparityMap(
        name="front",
        left=camera(),
        right=camera("right"),
        valid=RNG.random((5, 7)) > 0.5,
        weak=RNG.random((5, 7)) > 0.5,
        **pages,
    )


def tetrahedron() -> TriangleMesh:
    corners = np.array([[0, 0, 0], [1.1, 0, 0], [0, 1, 0], [0, 0, 1 / 3]])
    return TriangleMesh(vertices=corners, faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32))


def repaired() -> RepairedSurface:
    return RepairedSurface(
        mesh=tetrahedron(),
        provenance=np.array([0, 1, 2, 2], np.uint8),
        sigma_mm=np.array([np.nan, np.nan, 0.1, 0.2], np.float32),
        pair_bits=np.array([0, 0, 1, 3], np.int32),
        pair_names=("front", "floor"),
        convergence=np.array([0.5, 0.25]),
    )


def test_disparity_is_a_float_tiff_that_others_read(tmp_path: Path) -> None:
    value = disparity_map()
    encode(value, tmp_path, "disparity/front")
    read = decode(tmp_path, "disparity/front")
    for name in ("d_h_px", "d_v_px", "confidence", "sigma_px", "valid", "weak"):
        np.testing.assert_array_equal(getattr(read, name), getattr(value, name))
        assert getattr(read, name).dtype == getattr(value, name).dtype
    assert (read.name, read.left.name, read.right.name) == ("front", "left", "right")
    np.testing.assert_array_equal(read.left.camera_from_world.matrix, value.left.camera_from_world.matrix)
    with tifffile.TiffFile(tmp_path / "disparity" / "front.tif") as tiff:
        assert [page.tags[285].value for page in tiff.pages] == [
            "d_h_px",
            "d_v_px",
            "confidence",
            "sigma_px",
            "valid",
            "weak",
        ]
        np.testing.assert_array_equal(tiff.pages[0].asarray(), value.d_h_px)


def test_mesh_is_a_ply_that_others_read(tmp_path: Path) -> None:
    surface = repaired()
    colours = np.arange(12, dtype=np.uint8).reshape(4, 3)
    value = FinishedSurface(repaired=surface, textured=TexturedMesh(mesh=surface.mesh, colours=colours))
    encode(value, tmp_path, "mesh")
    other = trimesh.load(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(other.vertices, surface.mesh.vertices)
    np.testing.assert_array_equal(other.faces, surface.mesh.faces)
    np.testing.assert_array_equal(other.visual.vertex_colors[:, :3], colours)
    read = decode(tmp_path, "mesh")
    np.testing.assert_array_equal(read.textured.colours, colours)
    assert read.repaired.pair_names == ("front", "floor")
    assert read.repaired.provenance[2] == Provenance.MEASURED
    for name in ("provenance", "sigma_mm", "pair_bits", "convergence"):
        np.testing.assert_array_equal(getattr(read.repaired, name), getattr(surface, name))


@pytest.mark.parametrize(("product", "kind"), [("first", TriangleMesh), ("repaired", RepairedSurface)])
def test_earlier_meshes_come_back_as_what_they_were(tmp_path: Path, product: str, kind: type) -> None:
    encode(tetrahedron() if kind is TriangleMesh else repaired(), tmp_path, product)
    assert type(decode(tmp_path, product)) is kind


def test_cameras_json_is_documented_and_whole(tmp_path: Path) -> None:
    rig = Rig(name="r", cameras={n: camera(n) for n in ("left", "right")}, pair_names={"front": ("left", "right")})
    value = CameraSet(
        rig=rig,
        std={"left": {"fx_px": 0.02}},
        world="the board of pose 00",
        rms_px=0.03,
        verdict="warn",
        notices=(Notice(code="pair-without-target", about=("front",)),),
    )
    encode(value, tmp_path, "cameras")
    table = json.loads((tmp_path / "cameras.json").read_text())
    left = table["cameras"]["left"]
    assert left["image_size"] == [7, 5]
    point = np.array([10.0, -20.0, 500.0])
    x, y, z = np.array(left["R"]) @ point + np.array(left["t"])
    uv = np.array(left["K"]) @ [x / z, y / z, 1]
    np.testing.assert_allclose(uv[:2], camera().project(point), atol=1e-9)
    read = decode(tmp_path, "cameras")
    assert read.notices == value.notices
    assert (read.std, read.world, read.rms_px) == ({"left": {"fx_px": 0.02}}, value.world, 0.03)
    assert dict(read.rig.pair_names) == {"front": ("left", "right")}


def test_observations_come_back(tmp_path: Path) -> None:
    target = CharucoTarget(squares=(5, 4), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")
    seen = Detection(
        camera="left", pose="00", ids=np.array([0, 3]), uv=RNG.random((2, 2)), covariance_px2=RNG.random((2, 2, 2))
    )
    missed = MissedView(camera="right", pose="00", found="a mirrored board", remedy="Do not flip it")
    value = Observations(target=target, sizes_wh={"left": (7, 5)}, detections=(seen,), missed=(missed,))
    encode(value, tmp_path, "observations/00")
    read = decode(tmp_path, "observations/00")
    assert read.missed == (missed,)
    assert read.target == target
    assert dict(read.sizes_wh) == {"left": (7, 5)}
    np.testing.assert_array_equal(read.detections[0].uv, seen.uv)


def test_boundaries_are_readable_json_too(tmp_path: Path) -> None:
    curve = RNG.random((6, 3))
    encode((Boundary(name="model", points_world=curve, method="Drawn."),), tmp_path, "boundaries")
    table = json.loads((tmp_path / "boundaries.json").read_text())
    np.testing.assert_array_equal(table["boundaries"]["model"]["points"], curve)
    (read,) = decode(tmp_path, "boundaries")
    assert read.sigma_mm is None
    np.testing.assert_array_equal(read.points_world, curve)


def test_codes_are_read_out_of_sentences_of_version_1_0() -> None:
    curve = RNG.random((6, 3))
    tree = {"$value": "measure.boundary:Boundary", "name": "left", "points_world": {"$array": "a0"}}
    for method, kept, remarks in (
        ("given: 9 points, edited by hand", "given: 9 points, edited by hand", ("given",)),
        ("automatic. The body shows the head; to be confirmed by eye", "automatic. The body shows the head", CONFIRM),
        ("automatic. The body does not show where the head is: it is taken as given; to be confirmed by eye",
         "automatic. The body does not show where the head is: it is taken as given", ("head-not-shown", *CONFIRM)),
        ("base rim: 9 points", "base rim: 9 points", ()),
    ):  # fmt: skip
        read = from_tree(tree | {"method": method}, {"a0": curve})
        assert (read.method, read.remarks) == (kept, remarks)
    mark = {
        "$value": "measure.landmarks:Landmark",
        "name": "midline",
        "points_world": {"$array": "a0"},
        "sigma_mm": 1.0,
    }
    assert from_tree(mark | {"method": "proposed: the plane; to be confirmed by eye"}, {"a0": curve}).proposed
    assert not from_tree(mark | {"method": "picked by hand, or loaded"}, {"a0": curve}).proposed
    written: dict[str, np.ndarray] = {}
    made = Boundary(name="left", points_world=curve, method="given: as one may write; to be confirmed by eye")
    assert from_tree(to_tree(made, written), written).remarks == ()


def test_sentences_of_version_1_0_on_a_side_without_a_breast_and_the_body_are_read() -> None:
    point = np.zeros(3)
    tree = {
        "$value": "measure.boundary:NoBreast", "name": "left", "place_world": {"$array": "a"}, "standing": None,
        "why": "It is said to be removed", "unclear": False, "refused": False,
    }  # fmt: skip
    side = from_tree(tree, {"a": point})
    assert (side.reason.code, side.reason.values) == ("sentence", {"text": "It is said to be removed"})
    assert from_tree(to_tree(side, arrays := {}), arrays).reason == side.reason
    body = {
        "$value": "measure.body:Body", "frame": {"$array": "f"}, "point_world": {"$array": "a"},
        "plane_sigma_mm": None, "scatter_mm": None,
    }  # fmt: skip
    arrays = {"a": point, "f": np.eye(3)}
    for how, by_breasts in (("Left and ahead are as the breasts lie, because", True), ("roughly as given", False)):
        assert from_tree(body | {"how": how}, arrays).by_breasts is by_breasts


def test_infinite_and_missing_numbers_survive() -> None:
    value = {"a": float("inf"), 2: (None, True, "x", [1.5])}
    arrays: dict[str, np.ndarray] = {}
    tree = json.loads(json.dumps(to_tree(value, arrays), allow_nan=False))
    assert from_tree(tree, arrays) == value


def test_a_foreign_type_is_neither_kept_nor_made() -> None:
    with pytest.raises(TypeError, match="Path"):
        to_tree(Path(), {})
    for label in ("os:system", "errors:MammometryError", "geometry.camera:nothing"):
        with pytest.raises(StorageError):
            from_tree({"$value": label}, {})


@pytest.mark.parametrize("product", ["disparity/front", "mesh", "observations/00"])
@pytest.mark.parametrize("keep", [0, 100, 0.7])
def test_cut_files_are_told(tmp_path: Path, product: str, keep: float) -> None:
    surface = repaired()
    values = {
        "disparity/front": (disparity_map(), ".tif"),
        "mesh": (
            FinishedSurface(
                repaired=surface, textured=TexturedMesh(mesh=surface.mesh, colours=np.zeros((4, 3), np.uint8))
            ),
            ".ply",
        ),
        "observations/00": (replace(disparity_map()), ".npz"),
    }
    value, ending = values[product]
    encode(value, tmp_path, product)
    path = tmp_path / f"{product}{ending}"
    whole = path.read_bytes()
    path.write_bytes(whole[: int(keep * len(whole)) if keep < 1 else int(keep)])
    with pytest.raises(StorageError, match=path.name):
        decode(tmp_path, product)


LABELS_EVER_WRITTEN = """
calibration.calibrated:Calibration
calibration.calibrated:ParameterCovariance
calibration.calibrated:SetAside
calibration.detect:Detection
calibration.detect:MissedView
calibration.detect:Observations
calibration.left_out:LeftOut
calibration.target:CharucoTarget
calibration.target:ChessboardTarget
calibration.target:CirclesTarget
calibration.target:DottedCylinderTarget
calibration.target:PointsTarget
geometry.camera:Camera
geometry.camera:Rig
geometry.mesh:TriangleMesh
geometry.transform:Transform
matching.foreground:Foreground
matching.match:DisparityMap
measure.anthropometry:Dimensions
measure.boundary:Boundary
measure.landmarks:Landmark
measure.linear:LinearMeasure
measure.linear:Ptosis
measure.shape:BreastShape
measure.symmetry:Symmetry
measure.volume:VolumeMeasurement
surface.atlas:Atlas
surface.dents:Kept
surface.dents:ValidPatches
surface.range_image:RangeImage
"""


def test_labels_on_disk_never_change() -> None:
    """Results of every earlier version stay readable: a label may be added, never taken away."""
    assert set(LABELS_EVER_WRITTEN.split()) <= set(STORED_TYPES)


@pytest.mark.parametrize("label", sorted(STORED_TYPES))
def test_each_label_names_a_type_of_ours(label: str) -> None:
    module, _, name = STORED_TYPES[label].partition(":")
    kind = getattr(importlib.import_module(module), name)
    assert dataclasses.is_dataclass(kind)
    assert kind.__module__ == module, "a type is named where it is defined"


@pytest.mark.parametrize(("label", "first_names"), STORED_FIELDS.items())
def test_a_renamed_field_keeps_its_first_name_on_disk(label: str, first_names: Mapping[str, str]) -> None:
    module, _, name = STORED_TYPES[label].partition(":")
    names = {field.name for field in dataclasses.fields(getattr(importlib.import_module(module), name))}
    assert set(first_names) <= names
    assert names.isdisjoint(first_names.values())
    reason = to_tree(Notice(code="no-breast", about=("left",)), {})
    own = {"name": "left", "reason": reason, "unclear": True, "refused": False, "standing": None}  # types are checked
    tree = {"$value": label, **{field: own.get(field, 1.0) for field in names - set(first_names)}}
    tree |= {field: own.get(field, 1.0) for field in first_names.values()}
    assert to_tree(from_tree(tree, {}), {}) == tree


def test_what_is_deflated_is_read_by_everybody(tmp_path: Path) -> None:
    """By Python's archives and by another reader of TIFF."""
    write_arrays(tmp_path / "a.npz", {"a": np.arange(50_000)})
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        assert archive.testzip() is None
        assert {member.compress_type for member in archive.infolist()} == {zipfile.ZIP_DEFLATED}
    value = disparity_map()
    write_raster(tmp_path / "a.tif", value)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        np.testing.assert_array_equal(tiff.pages[0].asarray(), value.d_h_px)
    again = read_raster(tmp_path / "a.tif")
    for name in ("d_h_px", "confidence", "valid"):
        np.testing.assert_array_equal(getattr(again, name), getattr(value, name))


def photographed(shape: tuple[int, int] = (150, 90)) -> DisparityMap:
    """A smooth map in steps, with gaps, over more than one strip."""
    steps = np.add.outer(np.arange(shape[0]), -3 * np.arange(shape[1]))
    valid = RNG.random(shape) > 0.1
    fields = {name: (steps * 2.0**-8 * valid).astype(np.float32) for name in ("d_h_px", "d_v_px", "confidence")}
    sigma_px = np.where(valid, np.float32(0.03125), np.float32(np.nan))
    return DisparityMap(
        name="front", left=camera(), right=camera("right"), valid=valid, weak=~valid, sigma_px=sigma_px, **fields
    )


def test_rasters_are_read_by_libtiff(tmp_path: Path) -> None:
    """Floats that are written as differences: Pillow reads them with libtiff, as GDAL and OpenCV do."""
    value = photographed()
    write_raster(tmp_path / "a.tif", value)
    with Image.open(tmp_path / "a.tif") as picture:
        for page, name in enumerate(("d_h_px", "d_v_px", "confidence", "sigma_px", "valid", "weak")):
            picture.seek(page)
            np.testing.assert_array_equal(np.asarray(picture), getattr(value, name))
    import cv2

    read, pages = cv2.imreadmulti(str(tmp_path / "a.tif"), flags=cv2.IMREAD_UNCHANGED)
    assert read
    np.testing.assert_array_equal(pages[0], value.d_h_px)
    assert read_raster(tmp_path / "a.tif").d_h_px.tobytes() == value.d_h_px.tobytes()
    assert (tmp_path / "a.tif").stat().st_size < value.d_h_px.nbytes


def test_rasters_of_earlier_versions_are_read(tmp_path: Path) -> None:
    """Their floats are plain: what a file says of itself decides."""
    value = photographed()
    write_raster(tmp_path / "a.tif", value)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        about = tiff.pages.first.description
    with tifffile.TiffWriter(tmp_path / "old.tif") as tiff:
        for page, name in enumerate(("d_h_px", "d_v_px", "confidence", "sigma_px", "valid", "weak")):
            array = getattr(value, name)
            tiff.write(
                array.astype(np.uint8) if array.dtype == bool else array,
                description=about if page == 0 else None,
                metadata=None,
                compression="zlib",
                rowsperstrip=64,
            )
    read = read_raster(tmp_path / "old.tif")
    for name in ("d_h_px", "sigma_px", "valid"):
        np.testing.assert_array_equal(getattr(read, name), getattr(value, name))


def test_kept_data_are_a_mask_over_the_range_images(tmp_path: Path) -> None:
    keep = tuple(RNG.random((70, 50)) > 0.4 for _ in range(2))
    angles_rad = tuple(np.full((70, 50), angle, np.float32) for angle in (0.5, np.nan))
    encode(KeepMasks(keep=keep, angles_rad=angles_rad), tmp_path, "valid")
    with tifffile.TiffFile(tmp_path / "valid.tif") as tiff:
        assert [page.tags[285].value for page in tiff.pages] == ["keep.0", "keep.1", "angles_rad.0", "angles_rad.1"]
    read = decode(tmp_path, "valid")
    for ours, theirs in zip((*keep, *angles_rad), (*read.keep, *read.angles_rad), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_the_covering_picture_is_kept_once_and_is_what_its_file_shows(tmp_path: Path) -> None:
    mesh = tetrahedron()
    picture = RNG.integers(0, 255, (40, 30, 3)).astype(np.uint8)
    uv_px = RNG.random((4, 3, 2)).astype(np.float32) * 20
    drawn = Atlas(mesh=mesh, uv_px=uv_px, picture=picture, view=np.zeros(4, np.int64), names=("front",))
    made = as_jpeg(drawn)
    assert np.any(made.picture != picture)
    encode(made, tmp_path, "model")
    read = decode(tmp_path, "model")
    np.testing.assert_array_equal(read.picture, made.picture)
    assert jpeg_of(read) == (tmp_path / "model.jpg").read_bytes()
    with Image.open(tmp_path / "model.jpg") as shown:
        np.testing.assert_array_equal(np.asarray(shown), made.picture)
    assert as_jpeg(read) is read
