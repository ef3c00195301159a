"""A scan's mesh from its file to its volume: the same however it is written, and every refusal in words of a mesh."""

import ast
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tests.first_cases import first
from tests.mesh_contents import read_triangles
from tests.unit.measure.trunks import LEFT, RADIUS_MM, RIGHT, bump_mm, edge_of, trunk_mesh

import mammometry
from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MeasureError, SessionError
from mammometry.cli import main
from mammometry.geometry.mesh import TriangleMesh, joined
from mammometry.io.meshes.foreign import read_foreign
from mammometry.measure import scanned
from mammometry.measure.boundary.boundary import Boundary, outline_torso
from mammometry.measure.scan_front import front_of_body
from mammometry.measure.scan_repair import RepairedScan, largest_part, repair_scan
from mammometry.measure.trunk.body import find_body
from mammometry.measure.trunk.thorax import find_trunk, seen_skin
from mammometry.measure.volume.uncertainty import EarlierErrors, VolumeEvidence
from mammometry.measure.volume.volumes import measure_volumes
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.simulate.subjects.registry import make_subject

SOURCE = Path(mammometry.__file__).parent
CURVES = {"left": edge_of(LEFT, "left").points_world}
FRAME = np.eye(3)


@cache
def front() -> TriangleMesh:
    mesh = trunk_mesh(8.0)
    return mesh.submesh(mesh.corners().mean(axis=1)[:, 2] > -40)


def export(mesh: TriangleMesh, path: Path) -> Path:
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    return path


def volumes_cc(
    mesh: TriangleMesh, move: Callable[[np.ndarray], np.ndarray] = lambda points: points
) -> dict[str, float]:
    """Volumes within drawn curves, moved with the mesh."""
    curves = {name: move(points) for name, points in CURVES.items()}
    scan = scanned.finer_scan(repair_scan(mesh), list(curves.values()))
    surface = scanned.as_scanned(scan.mesh, scan.invented)
    frame = (move(np.concatenate([FRAME, np.zeros((1, 3))])) - move(np.zeros((1, 3))))[:3]
    boundaries = [Boundary(name=name, points_world=points, method="drawn") for name, points in curves.items()]  # type: ignore[arg-type]
    return {
        breast.boundary.name: chest_wall.fit(breast).closed.volume_mm3() / 1000
        for breast in open_breasts(boundaries, surface, frame=frame)
    }


@cache
def true_cc() -> dict[str, float]:
    return volumes_cc(front())


def read(path: Path) -> TriangleMesh:
    vertices, faces, _ = read_triangles(path)
    return TriangleMesh(vertices=vertices, faces=faces)


def ply_by_trimesh(mesh: TriangleMesh, path: Path, *, encoding: str) -> None:
    path.write_bytes(
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type="ply", encoding=encoding)
    )


WRITTEN: dict[str, Callable[[TriangleMesh, Path], object]] = {
    "ascii.ply": lambda mesh, path: ply_by_trimesh(mesh, path, encoding="ascii"),
    "binary.ply": lambda mesh, path: ply_by_trimesh(mesh, path, encoding="binary"),
    "a.obj": export,
    "float32.stl": export,
    "a.glb": export,
}


@pytest.mark.parametrize("name", first(2, WRITTEN))
def test_the_format_does_not_change_the_volume(tmp_path: Path, name: str) -> None:
    WRITTEN[name](front(), tmp_path / name)
    assert volumes_cc(read(tmp_path / name)) == pytest.approx(true_cc(), rel=2e-3)


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10**6), turned=st.booleans(), far_m=st.sampled_from([0.0, 0.3, 10.0]), doubled=st.booleans())
def test_order_place_and_doubled_vertices_do_not_change_the_volume(
    seed: int, turned: bool, far_m: float, doubled: bool
) -> None:
    random = np.random.default_rng(seed)
    mesh = front()
    rotation = Rotation.random(random_state=seed).as_matrix() if turned else np.eye(3)

    def move(points: np.ndarray) -> np.ndarray:
        return points @ rotation.T + 1000 * far_m * np.array([1.0, -0.5, 0.2])

    places = random.permutation(len(mesh.vertices))
    vertices, faces = mesh.vertices[places], np.argsort(places)[mesh.faces]
    faces = np.roll(faces[random.permutation(len(faces))], int(random.integers(3)), axis=1)
    if doubled:  # every face has corners of its own, a little apart
        vertices = vertices[faces].reshape(-1, 3) + random.uniform(-0.01, 0.01, (faces.size, 3))
        faces = np.arange(faces.size).reshape(-1, 3)
    changed = TriangleMesh(vertices=move(vertices), faces=np.ascontiguousarray(faces, dtype=np.int32))
    assert volumes_cc(changed, move) == pytest.approx(true_cc(), rel=5e-3)


def test_faces_split_in_three_do_not_change_the_volume() -> None:
    mesh = front()
    a, b, c = mesh.faces.T
    middle = len(mesh.vertices) + np.arange(len(mesh.faces))
    faces = np.concatenate([np.stack([p, q, middle], axis=1) for p, q in ((a, b), (b, c), (c, a))])
    split = TriangleMesh(
        vertices=np.concatenate([mesh.vertices, mesh.corners().mean(axis=1)]), faces=faces.astype(np.int32)
    )
    assert volumes_cc(split) == pytest.approx(true_cc(), rel=5e-3)


@pytest.mark.slow
def test_the_trunks_axis_does_not_hang_on_the_order_of_faces_or_on_a_micron() -> None:
    """It was off by a millimetre and a fifth of a degree: one in so many faces was sampled, in their order."""
    mesh = scanned.finer_scan(RepairedScan.unchanged(front()), [front().vertices]).mesh
    random = np.random.default_rng(0)
    trunk = find_trunk(seen_skin(scanned.as_scanned(mesh)), FRAME)
    shuffled = TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[random.permutation(len(mesh.faces))])
    again = find_trunk(seen_skin(scanned.as_scanned(shuffled)), FRAME)
    assert np.array_equal(trunk.origin, again.origin)
    moved = front().mapped(lambda points: points + random.normal(0, 1e-3, points.shape))
    moved = scanned.finer_scan(RepairedScan.unchanged(moved), [moved.vertices]).mesh
    again = find_trunk(seen_skin(scanned.as_scanned(moved)), FRAME)
    assert np.linalg.norm((trunk.origin - again.origin)[[0, 2]]) < 0.2
    assert np.arccos(np.clip(trunk.frame[1] @ again.frame[1], -1, 1)) < 5e-4


def test_a_files_order_of_vertices_and_faces_is_forgotten(tmp_path: Path) -> None:
    mesh, random = front(), np.random.default_rng(1)
    export(mesh, tmp_path / "a.ply")
    places = random.permutation(len(mesh.vertices))
    faces = np.roll(np.argsort(places)[mesh.faces][random.permutation(len(mesh.faces))], 1, axis=1)
    export(TriangleMesh(vertices=mesh.vertices[places], faces=faces.astype(np.int32)), tmp_path / "b.ply")
    one, other = read(tmp_path / "a.ply"), read(tmp_path / "b.ply")
    assert np.array_equal(one.vertices, other.vertices)
    assert np.array_equal(one.faces, other.faces)


@cache
def torso() -> TriangleMesh:
    return make_subject("torso_2", 1, edge_mm=7.0).mesh


def found_cc(mesh: TriangleMesh) -> dict[str, float]:
    """Volumes within boundaries that are found."""
    scan, rough = scanned.own_front(repair_scan(mesh), FRAME)
    scan = scanned.finer_scan(scan, [scan.mesh.vertices])
    surface = scanned.as_scanned(scan.mesh, scan.invented)
    boundaries = outline_torso(surface, rough).boundaries
    frame = find_body(surface, rough, boundaries=[boundary.points_world for boundary in boundaries]).frame
    return {
        breast.boundary.name: chest_wall.fit(breast).closed.volume_mm3() / 1000
        for breast in open_breasts(boundaries, surface, frame=frame)
    }


@pytest.mark.slow
def test_where_a_body_was_cut_does_not_change_the_volume() -> None:
    """The whole closed torso with its arms, and fronts that end behind its sides."""
    depth = torso().corners().mean(axis=1)[:, 2]
    meshes = [torso(), *(largest_part(torso().submesh(depth > depth.max() - cut)) for cut in (200.0, 260.0))]
    volumes = [found_cc(mesh) for mesh in meshes]
    for side in ("left", "right"):
        found = np.array([each[side] for each in volumes])
        assert np.abs(found / found.mean() - 1).max() < 0.02


def turned(mesh: TriangleMesh, pitch_deg: float, roll_deg: float) -> tuple[TriangleMesh, np.ndarray]:
    """The mesh turned in its file, and the rotation."""
    turn = Rotation.from_euler("zx", [roll_deg, pitch_deg], degrees=True).as_matrix()
    return mesh.mapped(lambda points: points @ turn.T), turn


@pytest.mark.slow
@pytest.mark.parametrize(("pitch_deg", "roll_deg"), first(1, [(20.0, 30.0), (40.0, 0.0), (-30.0, 0.0)]))
def test_a_front_is_cut_in_the_bodys_own_frame(pitch_deg: float, roll_deg: float) -> None:
    lying, turn = turned(front(), pitch_deg, roll_deg)
    scan, frame = scanned.own_front(repair_scan(lying), FRAME)
    assert frame[1] @ turn[:, 1] > np.cos(np.deg2rad(1.0))
    assert scan.mesh.area_mm2() == pytest.approx(
        scanned.own_front(repair_scan(front()), FRAME)[0].mesh.area_mm2(), rel=0.01
    )


def test_without_a_breast_in_the_bodys_own_frame_the_front_is_cut_by_the_files_axes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lying, _ = turned(front(), 20.0, 0.0)
    for by_axes in (True, False):
        found = iter([False, by_axes])
        monkeypatch.setattr(scanned, "facing_frame", lambda surface, frame, found=found: (frame, next(found)))
        _, frame = scanned.own_front(repair_scan(lying), FRAME)
        assert np.allclose(frame, FRAME) == by_axes


@pytest.mark.slow
def test_how_a_body_lies_in_its_file_does_not_change_the_volume() -> None:
    volumes = [
        found_cc(turned(torso(), *angles)[0]) for angles in ((0.0, 0.0), (40.0, 0.0), (-30.0, 0.0), (20.0, 30.0))
    ]
    for side in ("left", "right"):
        found = np.array([each[side] for each in volumes])
        assert np.abs(found / found.mean() - 1).max() < 0.02


@pytest.mark.slow
def test_neither_form_nor_a_hole_changes_a_volume_whose_boundary_is_found(tmp_path: Path) -> None:
    depth = torso().corners().mean(axis=1)[:, 2]
    front_alone = largest_part(torso().submesh(depth > depth.max() - 200))
    expected = found_cc(front_alone)
    for name in ("ascii.ply", "float32.stl"):
        WRITTEN[name](front_alone, tmp_path / name)
        assert found_cc(read(tmp_path / name)) == pytest.approx(expected, rel=0.01)
    places = front_alone.vertices
    tip = places[np.argmax(places[:, 2] - 1e3 * (places[:, 0] < 20))]  # foremost on the patient's left
    holed = front_alone.submesh(np.linalg.norm(front_alone.corners().mean(axis=1) - tip, axis=1) > 10)
    assert found_cc(holed) == pytest.approx(expected, rel=0.01)  # it was a third of it, without a word


def standing_body() -> TriangleMesh:
    """A tall smooth body with two feet that point to +x, y up."""
    body = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    body.apply_scale([120, 850, 220])
    legs = []
    for aside in (-100, 100):
        foot, shin = trimesh.creation.box(extents=[220, 60, 80]), trimesh.creation.box(extents=[90, 300, 80])
        foot.apply_translation([60, -850, aside])
        shin.apply_translation([0, -720, aside])
        legs += [foot, shin.subdivide().subdivide()]
    return joined(
        [TriangleMesh(vertices=np.array(part.vertices), faces=np.array(part.faces, np.int32)) for part in (body, *legs)]
    )


@pytest.mark.slow
def test_a_whole_bodys_feet_show_straight_ahead() -> None:
    assert scanned.frame_from_axes(standing_body())[2] == pytest.approx([1, 0, 0])
    z_up = standing_body().mapped(lambda points: np.ascontiguousarray(points[:, [2, 0, 1]]))  # y ahead
    frame = scanned.frame_from_axes(z_up)
    assert frame[1] == pytest.approx([0, 0, 1])
    assert frame[2] == pytest.approx([0, 1, 0])
    with pytest.raises(MeasureError, match=r"^mesh: .*--ahead z"):
        scanned.frame_from_axes(trunk_mesh(20.0))


def test_of_a_whole_body_the_trunks_front_is_left() -> None:
    scan = front_of_body(repair_scan(standing_body(), largest=True), np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]]))
    low, high = scan.mesh.vertices.min(axis=0), scan.mesh.vertices.max(axis=0)
    assert 0 < low[1] < 150
    assert 550 < high[1] < 680
    assert low[0] > -60
    assert scan.notices[-1].code == "front-of-trunk"


# --- what else stands in a scan ---


def plane(width_mm: float, height_mm: float, place: tuple[float, float, float], turn_deg: float = 0.0) -> TriangleMesh:
    """A wall before which a patient stands, or turned by 90° a floor."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 20) * width_mm, np.linspace(-0.5, 0.5, 20) * height_mm)
    noise = np.random.default_rng(1).normal(0.0, 2.0, x.shape)
    turn = Rotation.from_euler("x", turn_deg, degrees=True).as_matrix()
    return TriangleMesh(
        vertices=np.stack([x, y, noise], axis=-1).reshape(-1, 3) @ turn.T + place, faces=grid_faces(*x.shape)
    )


def grid_faces(rows: int, columns: int) -> np.ndarray:
    grid = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    two = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    return np.concatenate(two).astype(np.int32)


def test_a_wall_a_floor_and_a_chair_are_left_out_and_said() -> None:
    wall, floor = plane(1400, 1100, (0, 0, -220)), plane(900, 900, (0, -330, 100), 90.0)
    chair = trimesh.creation.box(extents=[60, 150, 60])
    chair.apply_translation([320, -100, -120])
    beside = [wall, floor, TriangleMesh(vertices=np.array(chair.vertices), faces=np.array(chair.faces, np.int32))]
    for things in (beside, beside[:1], beside[2:]):
        scan = repair_scan(joined([*things, front()]))
        assert scan.mesh.area_mm2() == pytest.approx(front().area_mm2(), rel=1e-6)
        code = "mesh-planes-removed" if things[0] is wall else "mesh-pieces-removed"
        assert [(notice.code, notice.values["pieces"]) for notice in scan.notices] == [(code, len(things))]
    assert len(repair_scan(plane(300, 300, (0, 0, 0))).mesh.faces) == 722  # alone it is what was scanned


@pytest.mark.slow
def test_hair_a_strap_and_a_hand_on_the_hip_do_not_change_the_volume() -> None:
    depth = torso().corners().mean(axis=1)[:, 2]
    alone = largest_part(torso().submesh(depth > depth.max() - 200))
    x, y, _ = alone.vertices.T
    nipple, top = alone.vertices[np.argmax(alone.vertices[:, 2])], y.max()
    strap_mm = 2.5 * (np.abs(np.abs(x) - 85) < 9) * (y > nipple[1] + 95)
    hair_mm = 12 * np.clip(1 - ((x - 70) / 22) ** 2, 0, None) * np.clip((y - (top - 90)) / 30, 0, 1)
    hand_mm = 28 * np.clip(1 - ((np.abs(x) - 135) ** 2 + (y - y.min() - 25) ** 2) / 45**2, 0, None)
    for lift_mm in (strap_mm, hair_mm, hand_mm):
        assert (lift_mm > 1).sum() > 20
        lifted = alone.mapped(lambda points, lift=lift_mm: points + lift[:, None] * alone.vertex_normals())  # type: ignore[misc]
        assert found_cc(lifted) == pytest.approx(found_cc(alone), rel=0.03)


def test_a_wall_that_hangs_on_the_body_is_cut_off() -> None:
    """As one depth picture shows a patient before a wall."""
    x, y = np.meshgrid(np.arange(-400, 401, 6.0), np.arange(-220, 221, 6.0))
    theta = np.arcsin(np.clip(x / RADIUS_MM, -1, 1))
    skin = RADIUS_MM * np.cos(theta) + bump_mm(theta, y, LEFT) + bump_mm(theta, y, RIGHT)
    depth = np.where(np.abs(x) < RADIUS_MM, skin, -100.0)
    mesh = TriangleMesh(vertices=np.stack([x, y, depth], axis=-1).reshape(-1, 3), faces=grid_faces(*x.shape))
    scan = front_of_body(repair_scan(mesh), FRAME)
    assert scan.mesh.vertices[:, 2].min() > -60
    assert np.ptp(scan.mesh.vertices[:, 0]) < 2.1 * RADIUS_MM
    assert [notice.code for notice in scan.notices] == ["front-of-trunk"]


# --- unit, head, ahead ---


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("cm", 0.1), ("m", 0.001)])
def test_a_torsos_size_shows_its_unit(tmp_path: Path, unit: str, factor: float) -> None:
    path = export(front().mapped(lambda points: points * factor), tmp_path / "a.ply")
    foreign = read_foreign(path, of_torso=True)
    assert foreign.units == f"{unit}, as the body's size shows"
    assert np.ptp(foreign.mesh.vertices, axis=0) == pytest.approx(np.ptp(front().vertices, axis=0), rel=1e-6)
    with pytest.raises(SessionError, match="--units"):
        read_foreign(path)
    if unit == "m":
        job = MeshJob(MeshFiles(mesh=path, automatic=True), tmp_path / "out")
        assert (job.notices[0].code, job.notices[0].values) == ("mesh-unit-assumed", {"unit": "m"})


def test_a_size_that_no_torso_has_in_any_unit_leaves_the_question(tmp_path: Path) -> None:
    path = export(front().mapped(lambda points: points * 6), tmp_path / "a.ply")
    with pytest.raises(SessionError, match=r"--units"):
        read_foreign(path, of_torso=True)


@pytest.mark.parametrize("angle_deg", [0, 12, 35, 60, 90, 135, 215])
def test_a_front_may_stand_diagonally_in_its_file(angle_deg: float) -> None:
    turn = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    frame = scanned.frame_from_axes(front().mapped(lambda points: points @ turn.T))
    apart = np.rad2deg(np.arccos(np.clip(frame[2] @ turn[:, 2], -1, 1)))
    assert apart < (13 if angle_deg == 12 else 3)  # near to an axis it stands along it
    assert frame[1] == pytest.approx([0, 1, 0])


# --- refusals ---


def flat_front() -> TriangleMesh:
    """The trunk without its breasts."""
    mesh = front()
    side = np.maximum(np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 2]), 1.0)  # the lids' middles stay
    return mesh.mapped(
        lambda points: (
            points
            * np.stack(
                [
                    np.where(side > 90, RADIUS_MM / side, 1),
                    np.ones(len(side)),
                    np.where(side > 90, RADIUS_MM / side, 1),
                ],
                axis=1,
            )
        )
    )


@pytest.mark.slow
def test_a_torso_without_breasts_is_refused_with_a_picture_unless_both_are_said_to_be_removed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = export(flat_front(), tmp_path / "flat.ply")
    folder = tmp_path / "out"
    call = ["measure", str(mesh), "--units", "mm", "--head", "y", "--out", str(folder), "--json"]
    assert main.run([*call, "--automatic"]) == 8
    answer = json.loads(capsys.readouterr().out)
    assert answer["code"] == "measurement"
    assert len(answer["details"]) == 2  # why each side has none
    assert "data:image/" in (folder / "refused" / "refused.html").read_text()
    removed = {"boundaries": {side: {"removed": True} for side in ("left", "right")}}
    (tmp_path / "b.json").write_text(json.dumps(removed))
    assert main.run([*call, "--boundary", str(tmp_path / "b.json")]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["volumes_cc"] == {}
    assert set(answer["no_breast"]) == {"left", "right"}
    assert not (folder / "refused" / "refused.html").exists()


@pytest.mark.requirement("R-VOL-6")
@pytest.mark.slow
def test_a_volume_that_is_known_no_better_than_by_half_is_refused() -> None:
    scan = scanned.finer_scan(repair_scan(front()), [CURVES["left"]])
    surface = scanned.as_scanned(scan.mesh, scan.invented)
    boundary = Boundary(name="left", points_world=CURVES["left"], method="drawn")

    def measured(scale_std: float) -> float:
        breasts = open_breasts([boundary], surface, frame=FRAME)
        return measure_volumes(breasts, VolumeEvidence(earlier=EarlierErrors(scale_std=scale_std)))[0].volume_cc

    assert measured(0.001) == pytest.approx(true_cc()["left"], rel=0.02)
    with pytest.raises(MeasureError, match=r"^breast 'left': .*\d+ ± \d+ cc \(scale ± \d+ cc"):
        measured(0.1)


_OF_PHOTOGRAPHS = ("session", "camera", "photograph", "rig", "mounting", "pair")
_CASTS_ALONE = ("cast_base.py", "cast_base_adjust.py", "cast_rim.py", "boundary.py", "cast.py")


def test_every_refusal_of_a_measurement_has_words_of_a_mesh() -> None:
    """Found and expected speak of the body alone. A remedy of photographs stands beside one of a mesh."""
    checked = 0
    for path in sorted((SOURCE / "measure").rglob("*.py")):
        if path.name in _CASTS_ALONE or "dates" in path.parts:
            continue  # casts before cameras, and visits compared
        for call in ast.walk(ast.parse(path.read_text())):
            if not (isinstance(call, ast.Call) and getattr(call.func, "id", "") in ("MeasureError", "CrossingError")):
                continue
            checked += 1
            words = {keyword.arg: ast.unparse(keyword.value).lower() for keyword in call.keywords}
            where = f"{path.relative_to(SOURCE)}:{call.lineno}"
            shown = [words.get("found", ""), words.get("expected", ""), words.get("mesh_remedy", words["remedy"])]
            for text in shown:
                spoken = [word for word in _OF_PHOTOGRAPHS if word in text.replace("unpaired", "").split()]
                spoken += [word for word in ("session.toml", "cameras", "photograph", "rig.") if word in text]
                assert not spoken, f"{where} says {spoken} of a mesh: {text}"
    assert checked > 20
