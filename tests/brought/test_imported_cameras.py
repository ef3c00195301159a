"""Cameras of other programs: points fall where the program's own formula puts them.

Each twin projects by the formula that the program documents, in its own pixels and units, which are then counted as
ours: from the first pixel's centre.
"""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from mammometry.base.errors import SessionError
from mammometry.geometry.camera import Camera
from mammometry.io.cameras.formats import import_cameras

PAIR = {"front": ("front_left", "front_right")}
WIDE, HIGH = 1280, 1024
K1, K2, K3, P1, P2 = -0.11, 0.07, -0.02, 0.0008, -0.0005
FX, FY, U0, V0 = 2110.0, 2123.5, 651.3, 498.8  # in our pixels
TURN = Rotation.from_euler("XYZ", [3.0, -14.0, 1.5], degrees=True)  # of the right camera in the left one's frame
BESIDE_MM = np.array([148.0, -3.0, 21.0])
WORLD_MM = np.random.default_rng(3).uniform([-90, -70, 480], [90, 70, 640], (60, 3))
"""In the left camera's frame."""


def in_right(points: np.ndarray) -> np.ndarray:
    return (points - BESIDE_MM) @ TURN.as_matrix()


def brown(x: np.ndarray, y: np.ndarray, tangential: tuple[float, float] = (P1, P2)) -> tuple[np.ndarray, np.ndarray]:
    p1, p2 = tangential
    r2 = x**2 + y**2
    radial = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y


def require_twin(cameras: dict[str, Camera], twin: Callable[[np.ndarray], np.ndarray], most_px: float = 1e-6) -> None:
    """Both cameras put points where the twin does, and the twin sees them within the picture."""
    assert set(cameras) >= {"front_left", "front_right"}
    for name, points in (("front_left", WORLD_MM), ("front_right", in_right(WORLD_MM))):
        expected = twin(points)
        assert ((expected > 0) & (expected < [WIDE, HIGH])).all()
        read = cameras[name].project(WORLD_MM)
        np.testing.assert_allclose(read, expected, rtol=0, atol=most_px, err_msg=name)


def plain(points: np.ndarray) -> np.ndarray:
    x, y = brown(points[:, 0] / points[:, 2], points[:, 1] / points[:, 2])
    return np.stack([U0 + FX * x, V0 + FY * y], axis=1)


# --- MATLAB ---


def matlab_lens(**changed: Any) -> dict[str, Any]:
    """As toStruct gives it: a matrix for row vectors, pixels from 1."""
    matrix = np.array([[FX, 0, 0], [0, FY, 0], [U0 + 1, V0 + 1, 1]])
    lens = {"IntrinsicMatrix": matrix, "RadialDistortion": [K1, K2, K3], "TangentialDistortion": [P1, P2],
            "ImageSize": [HIGH, WIDE], "WorldUnits": "millimeters", "EstimateSkew": False}  # fmt: skip
    return {**lens, **changed}


def matlab_pair(**changed: Any) -> dict[str, Any]:
    """[x y z] of camera 2 = [x y z] of camera 1 · R + t."""
    rotation = TURN.as_matrix()
    return {"CameraParameters1": matlab_lens(**changed), "CameraParameters2": matlab_lens(**changed),
            "RotationOfCamera2": rotation, "TranslationOfCamera2": -BESIDE_MM @ rotation, "Version": "9"}  # fmt: skip


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.requirement("R-IN-8")
def test_a_pair_of_matlab(tmp_path: Path, packed: bool) -> None:
    savemat(tmp_path / "rig.mat", {"s": matlab_pair(), "note": "ours"}, do_compression=packed)
    require_twin(import_cameras([tmp_path / "rig.mat"], PAIR), plain)


def test_newer_matlab_names_the_matrix_otherwise(tmp_path: Path) -> None:
    table = matlab_pair()
    for name in ("CameraParameters1", "CameraParameters2"):
        table[name]["K"] = table[name].pop("IntrinsicMatrix").T
    savemat(tmp_path / "rig.mat", {"s": table})
    require_twin(import_cameras([tmp_path / "rig.mat"], PAIR), plain)


@pytest.mark.parametrize(("unit", "mm"), [("cm", 10.0), ("m", 1000.0), ("in", 25.4)])
def test_lengths_of_matlab_are_converted(tmp_path: Path, unit: str, mm: float) -> None:
    table = matlab_pair(WorldUnits=unit)
    table["TranslationOfCamera2"] = table["TranslationOfCamera2"] / mm
    savemat(tmp_path / "rig.mat", {"s": table})
    require_twin(import_cameras([tmp_path / "rig.mat"], PAIR), plain)


def test_single_cameras_of_matlab_with_their_places(tmp_path: Path) -> None:
    """The world is the board before all of them."""
    paths = []
    places = (("front_left", np.eye(3), np.zeros(3)), ("front_right", TURN.as_matrix(), BESIDE_MM))
    for name, rotation, centre in places:
        paths.append(tmp_path / f"{name}.mat")
        savemat(paths[-1], {"p": matlab_lens(), "rotationMatrix": rotation, "translationVector": -centre @ rotation})
    require_twin(import_cameras(paths, PAIR), plain)


def opaque(name: bytes, kind: bytes) -> bytes:
    """A MAT-file of version 5 with an object as MATLAB saves it, as far as it names one."""

    def element(code: int, content: bytes) -> bytes:
        return struct.pack("<II", code, len(content)) + content + b"\0" * (-len(content) % 8)

    numbers = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    numbers += element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    variable = element(6, struct.pack("<II", 17, 0)) + element(1, name) + element(1, b"MCOS") + element(1, kind)
    variable += element(14, numbers)
    workspace = element(6, struct.pack("<II", 9, 0)) + element(5, struct.pack("<ii", 1, 8)) + element(1, b"")
    workspace += element(2, b"\0" * 8)
    head = b"MATLAB 5.0 MAT-file".ljust(116) + struct.pack("<Q", 0) + struct.pack("<HH", 0x0100, 0x4D49)
    return head + element(14, variable) + element(14, workspace)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512, b"\0"), r"7\.3, .*7.*'-v7'"),
        (opaque(b"stereoParams", b"stereoParameters"), r"found MATLAB's objects, .*toStruct\(stereoParams\)"),
        (b"\0" * 10, "MAT-file"),
        (b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + b"\x0f" * 40, r"rig\.mat: .*MAT-file"),
    ],
    ids=["7.3", "objects", "short", "damaged"],
)
def test_what_matlab_alone_can_read_is_named(tmp_path: Path, content: bytes, sentence: str) -> None:
    (tmp_path / "rig.mat").write_bytes(content)
    with pytest.raises(SessionError, match=sentence):
        import_cameras([tmp_path / "rig.mat"], PAIR)


@pytest.mark.parametrize(
    ("variables", "sentence"),
    [
        ({"s": matlab_pair(WorldUnits="furlongs")}, "'furlongs'"),
        ({"s": matlab_pair(ImageSize=[])}, "no ImageSize"),
        ({"s": matlab_pair(RadialDistortion=[1.0])}, r"\b1 radial"),
        ({"s": matlab_pair(IntrinsicMatrix=[[FX, 0, 0], [5, FY, 0], [U0, V0, 1]])}, r"skew|camera"),
        ({"p": matlab_lens()}, "pose"),
        ({"x": 3.0}, "variables x"),
    ],
)
def test_unfit_structures_of_matlab_are_named(tmp_path: Path, variables: dict[str, Any], sentence: str) -> None:
    savemat(tmp_path / "front_left.mat", variables)
    with pytest.raises(SessionError, match=sentence):
        import_cameras([tmp_path / "front_left.mat"], PAIR)


# --- Agisoft ---


def agisoft(*, b1: float = FX - FY, extra: str = "", labels: tuple[str, str] = ("front_left.jpg", "front_right.jpg"),
            world: Rotation = Rotation.identity(), moved_m: tuple[float, ...] = (0, 0, 0), scale: float = 0.001,
            sensor_type: str = "frame", component: bool = False) -> str:  # fmt: skip
    """As Metashape exports: the chunk's unit is a millimetre here, the world's a metre."""
    cameras = ""
    poses = ((np.eye(3), np.zeros(3)), (TURN.as_matrix(), BESIDE_MM))
    for number, (label, (rotation, centre)) in enumerate(zip(labels, poses, strict=True)):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, centre
        cameras += f'<camera id="{number}" sensor_id="0" component_id="0" label="{label}"><transform>'
        cameras += " ".join(repr(float(value)) for value in matrix.ravel()) + "</transform></camera>"
    place = f"<rotation>{' '.join(map(repr, world.as_matrix().ravel().tolist()))}</rotation>"
    place += f"<translation>{' '.join(map(repr, moved_m))}</translation><scale>{scale!r}</scale>"
    place = f"<transform>{place}</transform>" if scale else ""
    part = f'<components><component id="0">{place}</component></components>' if component else place
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true"><sensors next_id="1">
<sensor id="0" label="unknown" type="{sensor_type}"><resolution width="{WIDE}" height="{HIGH}"/>
<calibration type="{sensor_type}" class="initial"><resolution width="{WIDE}" height="{HIGH}"/><f>2000</f></calibration>
<calibration type="{sensor_type}" class="adjusted"><resolution width="{WIDE}" height="{HIGH}"/>
<f>{FY}</f><cx>{U0 + 0.5 - WIDE / 2!r}</cx><cy>{V0 + 0.5 - HIGH / 2!r}</cy><b1>{b1!r}</b1>
<k1>{K1}</k1><k2>{K2}</k2><k3>{K3}</k3><p1>{P1}</p1><p2>{P2}</p2>{extra}</calibration></sensor></sensors>
<cameras>{cameras}<camera id="9" sensor_id="0" label="not aligned"/></cameras>{part}</chunk></document>
"""


def agisoft_twin(points: np.ndarray) -> np.ndarray:
    """Metashape's appendix: u = w/2 + cx + x′ f + x′ B1, from the corner of the first pixel."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x**2 + y**2
    radial = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
    seen_x = x * radial + (P1 * (r2 + 2 * x**2) + 2 * P2 * x * y)
    seen_y = y * radial + (P2 * (r2 + 2 * y**2) + 2 * P1 * x * y)
    u = WIDE / 2 + (U0 + 0.5 - WIDE / 2) + seen_x * FY + seen_x * (FX - FY)
    v = HIGH / 2 + (V0 + 0.5 - HIGH / 2) + seen_y * FY
    return np.stack([u, v], axis=1) - 0.5  # pixel centres at halves


@pytest.mark.parametrize("component", [False, True])
@pytest.mark.parametrize("labels", [("front_left", "front_right"), ("front_left.jpg", "front_right.JPG"),
                                    ("front_left/0001.jpg", "front_right/0001.jpg")])  # fmt: skip
@pytest.mark.requirement("R-IN-8")
def test_cameras_of_agisoft(tmp_path: Path, component: bool, labels: tuple[str, str]) -> None:
    (tmp_path / "cameras.xml").write_text(agisoft(component=component, labels=labels))
    require_twin(import_cameras([tmp_path / "cameras.xml"], PAIR), agisoft_twin)


def test_a_chunk_that_lies_elsewhere_in_its_world(tmp_path: Path) -> None:
    """A chunk in tenths of a metre, turned and moved: the cameras stand as they stood to one another."""
    turned, moved_m = Rotation.from_euler("XYZ", [40, -70, 110], degrees=True), (3.0, -2.0, 1.0)
    (tmp_path / "cameras.xml").write_text(agisoft(world=turned, moved_m=moved_m))
    cameras = import_cameras([tmp_path / "cameras.xml"], PAIR)
    there = WORLD_MM @ turned.as_matrix().T + np.array(moved_m) * 1000
    for name, points in (("front_left", WORLD_MM), ("front_right", in_right(WORLD_MM))):
        np.testing.assert_allclose(cameras[name].project(there), agisoft_twin(points), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (agisoft(extra="<b2>0.3</b2>"), r"b2 = 0\.3, skew"),
        (agisoft(extra="<k4>0.01</k4>"), r"k4 = 0\.01"),
        (agisoft(scale=0), "scale"),
        (agisoft(sensor_type="fisheye"), "fisheye"),
        (agisoft(labels=("front_left.jpg", "front_left/2.jpg")), "front_left"),
        (agisoft(scale=6378.0, moved_m=(6.4e6, 0, 0)), "origin"),
        (agisoft().replace("<cx>", "<cx>1,5 "), "invalid"),
        ("<?xml version='1.0'?><document><chunk/></document>", r"\b0 chunks"),
        ("<?xml version='1.0'?><!DOCTYPE a><document/>", "a declaration"),
    ],
)
def test_unfit_cameras_of_agisoft_are_named(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "cameras.xml").write_text(text)
    with pytest.raises(SessionError, match=sentence):
        import_cameras([tmp_path / "cameras.xml"], PAIR)


# --- HALCON ---

FOCUS, SX, SY = 0.0125, 0.0125 / FX, 0.0125 / FY


def halcon(path: Path, **terms: float) -> Path:
    values = {"Focus": FOCUS, **terms, "Sx": SX, "Sy": SY, "Cx": U0, "Cy": V0}
    lines = ["# INTERNAL CAMERA PARAMETERS", "", "ParGroup: Camera: Parameter;", '  "Internal";', ""]
    for name, value in values.items():
        lines += [f"{name}:{name.lower()}:   {value!r};", "    DOUBLE:0.0:;", f'    "{name} of it [meter]";', ""]
    for name, pixels in (("ImageWidth", WIDE), ("ImageHeight", HIGH)):
        lines += [f"{name}:img:   {pixels};", "    INT:1:32767;", '    "pixels";', ""]
    path.write_text("\n".join(lines))
    return path


def halcon_pose(path: Path, code: int = 0, rotation: Rotation = TURN, centre_mm: np.ndarray = BESIDE_MM) -> Path:
    if code == 4:
        angles = rotation.as_rotvec() / rotation.magnitude() * np.tan(rotation.magnitude() / 2)
    else:
        angles = rotation.as_euler("XYZ" if code == 0 else "ZYX", degrees=True)[:: 1 if code == 0 else -1]
    path.write_text(
        f"#\n# 3D POSE PARAMETERS: rotation and translation\n#\n\n# Used representation type:\nf {code}\n\n"
        f"# Rotation angles [deg] or Rodriguez-vector:\nr {' '.join(map(repr, angles.tolist()))}\n\n"
        f"# Translational vector (x y z [m]):\nt {' '.join(map(repr, (centre_mm / 1000).tolist()))}\n"
    )
    return path


def halcon_twin(**terms: float) -> Callable[[np.ndarray], np.ndarray]:
    """Distorted points on the sensor whose ideal ones, by HALCON's formulas, are those that are seen."""

    def twin(points: np.ndarray) -> np.ndarray:
        ideal = FOCUS * points[:, :2] / points[:, 2:]
        kappa = terms.get("Kappa")
        if kappa is not None:
            r2 = (ideal**2).sum(axis=1, keepdims=True)
            seen = 2 * ideal / (1 + np.sqrt(1 - 4 * kappa * r2))
        else:
            k1, k2, k3, p1, p2 = (terms.get(f"Poly{number}", 0.0) for number in range(1, 6))
            seen = ideal.copy()
            for _ in range(100):
                x, y = seen.T
                r2 = x**2 + y**2
                radial = k1 * r2 + k2 * r2**2 + k3 * r2**3
                moved_x = x * radial + p1 * (r2 + 2 * x**2) + 2 * p2 * x * y
                moved_y = y * radial + 2 * p1 * x * y + p2 * (r2 + 2 * y**2)
                seen = ideal - np.stack([moved_x, moved_y], axis=1)
        return np.stack([seen[:, 0] / SX + U0, seen[:, 1] / SY + V0], axis=1)

    return twin


WEAK, STRONG, TYPICAL = {"Kappa": -60.0}, {"Kappa": -4000.0}, {"Kappa": -900.0}
POLYNOMIAL = {"Poly1": 600.0, "Poly2": 2e5, "Poly3": 0.0, "Poly4": 0.01, "Poly5": -0.02}


@pytest.mark.parametrize(
    ("terms", "most_px"),
    [({"Kappa": 0.0}, 1e-6), (WEAK, 1e-6), (TYPICAL, 0.01), (POLYNOMIAL, 0.01)],
    ids=["none", "weak", "typical", "polynomial"],
)
@pytest.mark.requirement("R-IN-8")
def test_cameras_of_halcon(tmp_path: Path, terms: dict[str, float], most_px: float) -> None:
    lenses = [halcon(tmp_path / f"{name}.cal", **terms) for name in PAIR["front"]]
    relative = halcon_pose(tmp_path / "relpose.dat")
    require_twin(import_cameras([*lenses, relative], PAIR), halcon_twin(**terms), most_px)


@pytest.mark.parametrize("code", [0, 2, 4])
def test_every_pose_of_halcon_is_turned_as_it_says(tmp_path: Path, code: int) -> None:
    paths = [halcon(tmp_path / f"{name}.dat", Kappa=0.0) for name in PAIR["front"]]
    paths.append(halcon_pose(tmp_path / "front_left_pose.dat", code, Rotation.identity() if code != 4 else
                             Rotation.from_rotvec([1e-12, 0, 0]), np.zeros(3)))  # fmt: skip
    paths.append(halcon_pose(tmp_path / "campose_front_right.dat", code))
    require_twin(import_cameras(paths, PAIR), halcon_twin(Kappa=0.0))


def test_a_lens_that_browns_does_not_fit_is_refused(tmp_path: Path) -> None:
    paths = [halcon(tmp_path / f"{name}.cal", **STRONG) for name in PAIR["front"]]
    with pytest.raises(SessionError, match=r"^front_left\.cal: .*0\.\d+ pixels"):
        import_cameras([*paths, halcon_pose(tmp_path / "relpose.dat")], PAIR)


def test_unfit_files_of_halcon_are_named(tmp_path: Path) -> None:
    left, right = (halcon(tmp_path / f"{name}.cal", Kappa=0.0) for name in PAIR["front"])
    with pytest.raises(SessionError, match="of front_left, front_right: "):
        import_cameras([left, right], PAIR)
    with pytest.raises(SessionError, match=r"^a_pose\.dat: .*\b8, .*0, 2 or 4"):
        import_cameras([left, right, halcon_pose(tmp_path / "a_pose.dat", 8)], PAIR)
    pose = halcon_pose(tmp_path / "relpose.dat")
    for before, after, sentence in (
        ("Kappa:kappa:", "Tilt:tilt:", "found Tilt: 0.0"),
        ("Focus:focus:   0.0125", "Focus:focus:   0.0", "Focus, Sx or Sy not above zero"),
        ("Focus:focus:   0.0125;", "", "no focus"),
        ("Camera:", "LinescanCamera:", "another parameter group"),
    ):
        left.write_text(halcon(left, Kappa=0.0).read_text().replace(before, after))
        with pytest.raises(SessionError, match=sentence):
            import_cameras([left, right, pose], PAIR)


# --- names in folders and topics ---


def colmap(folder: Path, images: tuple[str, str]) -> list[Path]:
    (folder / "cameras.txt").write_text(
        f"1 OPENCV {WIDE} {HIGH} {FX} {FY} {U0 + 0.5!r} {V0 + 0.5!r} {K1} {K2} {P1} {P2}\n"
    )
    inverse = TURN.inv()
    x, y, z, w = inverse.as_quat().tolist()
    t = (-inverse.apply(BESIDE_MM)).tolist()
    (folder / "images.txt").write_text(
        f"1 1 0 0 0 0 0 0 1 {images[0]}\n\n2 {w!r} {x!r} {y!r} {z!r} {t[0]!r} {t[1]!r} {t[2]!r} 1 {images[1]}\n\n"
    )
    return [folder / "cameras.txt", folder / "images.txt"]


@pytest.mark.parametrize(
    "images",
    [("front_left.jpg", "front_right.jpg"), ("front_left/0001.jpg", "front_right/0001.jpg"),
     ("rig/front_left/a.png", "rig/front_right/a.png"), ("front_left\\1.jpg", "front_right\\1.jpg")],
)  # fmt: skip
def test_images_of_colmap_in_a_folder_for_each_camera(tmp_path: Path, images: tuple[str, str]) -> None:
    cameras = import_cameras(colmap(tmp_path, images), PAIR)
    assert list(cameras) == ["front_left", "front_right"]
    np.testing.assert_allclose(cameras["front_right"].centre_world, BESIDE_MM, atol=1e-9)


def test_a_second_image_of_one_camera_is_named(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"^images\.txt, line 3: .*\bfront_left"):
        import_cameras(colmap(tmp_path, ("front_left/0001.jpg", "front_left/0002.jpg")), PAIR)


def camchain(folder: Path, topics: tuple[str, str]) -> list[Path]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN.inv().as_matrix(), -TURN.inv().apply(BESIDE_MM) / 1000
    lines = []
    for number, topic in enumerate(topics):
        lines += [f"cam{number}:", "  camera_model: pinhole", "  distortion_model: none", "  distortion_coeffs: []"]
        lines += [f"  intrinsics: [{FX}, {FY}, {U0}, {V0}]", f"  resolution: [{WIDE}, {HIGH}]", f"  rostopic: {topic}"]
        lines += [f"  T_cn_cnm1: {matrix.tolist()}"] if number else []
    (folder / "camchain.yaml").write_text("\n".join(lines))
    return [folder / "camchain.yaml"]


@pytest.mark.parametrize("form", ["/{}/image_raw", "/rig/{}/image_raw", "/rig/{}", "{}"])
def test_topics_of_kalibr_may_begin_with_the_rig(tmp_path: Path, form: str) -> None:
    topics = (form.format("front_left"), form.format("front_right"))
    cameras = import_cameras(camchain(tmp_path, topics), PAIR)
    assert list(cameras) == ["front_left", "front_right"]


def test_topics_that_name_no_camera_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"^camchain\.yaml, cam1: .*/rig/right/image_raw"):
        import_cameras(camchain(tmp_path, ("/rig/left/image_raw", "/rig/right/image_raw")), PAIR)
