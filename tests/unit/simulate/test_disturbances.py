"""What a clinic does to a capture: exact volumes, angles and moments as asked for, the same for the same seed."""

import functools
import math

import manifold3d
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mammometry.simulate.disturbances.about import Surroundings
from mammometry.simulate.disturbances.draw import OF_OTHER_CAPTURES, draw, is_held_out
from mammometry.simulate.disturbances.exposure import CaptureConditions, plain_exposure, shifted
from mammometry.simulate.disturbances.registry import DISTURBANCES, Word, check, disturbed
from mammometry.simulate.disturbances.surfaces import ball, bar, box, merged, straight
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.rendering.develop import magnified
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.render import render_subject
from mammometry.simulate.rendering.scene import Room, SubjectMotion, light_scene, moved
from mammometry.simulate.rendering.skin import SKINS, SkinReflectance
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.subjects.body import TrunkField
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.shapes import sphere
from mammometry.simulate.subjects.solid import SubjectSolid, rig_from_solid
from mammometry.simulate.subjects.torso_shape import torso_shape

_NAMES = tuple(DISTURBANCES)


@functools.cache
def operated(text: str, name: str = "torso_3") -> SubjectSolid:
    situation = parse_situation(text)
    reshape = functools.partial(disturbed, stage="patient", situation=situation, seed=7)
    return make_subject(name, 7, edge_mm=4.0, reshape=reshape)


def exposed(text: str, rig: str = "reference", scale: float = 0.05) -> CaptureConditions:
    plain = plain_exposure(make_rig(rig, scale, 3), flashes(), Film())
    found: CaptureConditions = disturbed(plain, "shoot", parse_situation(text), 5)
    return found


def manifold_cc(solid: SubjectSolid, side: str) -> float:
    mesh = solid.closed_breast(side)
    body = manifold3d.Manifold(
        manifold3d.Mesh64(vert_properties=np.array(mesh.vertices), tri_verts=np.array(mesh.faces, dtype=np.uint64))
    )
    return float(body.volume()) / 1000.0


@pytest.mark.slow
def test_a_removed_side_has_no_volume_and_says_so():
    one = operated("removed=right,scar,loose-skin")
    assert set(one.volumes_cc) == {"left"}
    assert one.facts["removed"] == ("right",)
    assert "nipple_left" in one.landmarks
    assert "nipple_right" not in one.landmarks
    assert one.mesh.is_watertight()
    # Where the breast was, skin and chest wall are one, folds and scar included.
    assert one.wall_vertices is not None
    apart = np.linalg.norm(one.mesh.vertices - one.wall_vertices, axis=1) > 0
    assert not (apart & (one.mesh.vertices[:, 0] < -10.0)).any()


@pytest.mark.slow  # makes two bodies
def test_the_other_side_is_and_stands_as_it_did():
    whole, one = operated("skin"), operated("removed=right,scar,loose-skin")
    # The very same map; only the mesh beside it differs: edges of 4 mm, chords of 60 mm radius.
    assert one.volumes_cc["left"] == pytest.approx(whole.volumes_cc["left"], rel=2e-3)
    assert rig_from_solid(one, 7).matrix == pytest.approx(rig_from_solid(whole, 7).matrix, abs=1e-9)


@pytest.mark.slow
def test_scar_and_loose_skin_lift_and_colour_the_skin():
    marked = operated("removed=right,scar,loose-skin")
    assert marked.tint is not None
    assert marked.tint[:, 1].min() < 0.75  # green: the scar is red
    assert (marked.tint[:, 1] < 0.9).mean() < 0.05
    away = TrunkField(torso_shape("torso_3", 7).body)(marked.mesh.vertices)  # mm over the trunk without breasts, about
    right = (marked.mesh.vertices[:, 0] < -10.0) & (marked.mesh.vertices[:, 2] > 20.0)
    assert 3.0 < away[right].max() < 12.0  # the dog ear of 6 mm, and a fold of 2.7 mm, on edges of 8 mm
    assert away[right].min() < -0.7  # the scar's groove, and the drains' marks
    assert np.median(np.abs(away[right])) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    "volume_cc", [150.0, pytest.param(80.0, marks=pytest.mark.slow), pytest.param(400.0, marks=pytest.mark.slow)]
)
def test_a_mound_has_its_exact_volume_and_no_fold_nipple_or_areola(volume_cc):
    solid = operated(f"mound={volume_cc:g},scar")
    side = next(name for name in ("left", "right") if f"nipple_{name}" not in solid.landmarks)
    other = "left" if side == "right" else "right"
    assert solid.volumes_cc[side] == pytest.approx(volume_cc, rel=0.03)
    for name in (side, other):
        assert solid.closed_breast(name).is_watertight()
        assert solid.volumes_cc[name] == pytest.approx(manifold_cc(solid, name), rel=1e-6)
    assert solid.areola[np.unique(solid.mesh.faces[solid.breasts[side].skin_faces])].max() == 0.0
    assert solid.wall_vertices is not None

    def steepest_deg(name: str) -> float:
        """Angle between skin and wall, where they part."""
        breast = solid.breasts[name]
        faces = solid.mesh.faces[breast.skin_faces]
        rim = np.isin(faces, breast.boundary).any(axis=1)
        skin, wall = (
            np.cross(points[faces[rim, 1]] - points[faces[rim, 0]], points[faces[rim, 2]] - points[faces[rim, 0]])
            for points in (solid.mesh.vertices, solid.wall_vertices)
        )
        cosine = (skin * wall).sum(axis=1) / (np.linalg.norm(skin, axis=1) * np.linalg.norm(wall, axis=1))
        return float(np.degrees(np.percentile(np.arccos(np.clip(cosine, -1.0, 1.0)), 95)))

    assert steepest_deg(side) < 15.0 < 40.0 < steepest_deg(other)


@pytest.mark.slow
def test_ratio_of_the_sides_is_as_asked():
    volumes = operated("ratio=5").volumes_cc
    assert volumes["left"] / volumes["right"] == pytest.approx(5.0, rel=0.05)  # each is met to 2 %


@pytest.mark.slow
@pytest.mark.parametrize("below_mm", [10.0, 55.0])
def test_nipples_of_hanging_breasts_are_below_the_fold_as_asked(below_mm):
    solid = operated(f"posture=standing,hanging={below_mm:g}")
    assert solid.mesh.is_watertight()
    for side, volume_cc in solid.volumes_cc.items():
        assert 300.0 * 0.96 < volume_cc < 1500.0 * 1.04  # volumes are met to 2 % in finer meshes
        assert manifold_cc(solid, side) == pytest.approx(volume_cc, rel=1e-5)
        fold, nipple = (solid.landmarks[f"{name}_{side}"][0, 1] for name in ("inframammary_fold", "nipple"))
        assert fold - nipple == pytest.approx(below_mm, abs=9.0)  # ± 3 mm are drawn, and a nipple is up to 7 mm long
        skin = solid.mesh.vertices[solid.mesh.faces[solid.breasts[side].skin_faces]]
        assert skin[..., 1].min() < fold - below_mm  # it hangs over the chest below


@pytest.mark.slow
@pytest.mark.parametrize("text", ["arms=raised", "arms=frame", "arms=sides", "build=obese", "build=thin", "ptosis=3"])
def test_bodies_are_closed(text):
    solid = operated(text)
    assert solid.mesh.is_watertight()
    assert solid.mesh.components()[0] == 1
    assert set(solid.volumes_cc) == {"left", "right"}


def test_only_torsos_are_operated():
    with pytest.raises(ValueError, match="plaster_3"):
        operated("removed=right", "plaster_3")


@pytest.mark.parametrize(("text", "turned"), [("drift=0.02", 8), ("drift-one=0.05", 1)])
def test_drift_turns_cameras_by_the_angle_about_their_centres(text, turned):
    exposure, angle = exposed(text), float(text.partition("=")[2])
    found = []
    for name, camera in exposure.rig.cameras.items():
        now = exposure.capture_rig.cameras[name]
        assert now.centre_world == pytest.approx(camera.centre_world, abs=1e-9)
        turn = now.camera_from_world.rotation @ camera.camera_from_world.rotation.T
        # The sine of small angles, from the part of the matrix that is not symmetric.
        found.append(math.degrees(0.5 * np.linalg.norm(turn - turn.T) / math.sqrt(2.0)))
    assert sorted(found)[-turned:] == pytest.approx([angle] * turned, rel=1e-6)
    assert sorted(found)[: 8 - turned] == [0.0] * (8 - turned)


def test_a_pair_is_shifted_as_a_whole():
    exposure = exposed("pair-shift=2")
    shifts = {
        name: exposure.capture_rig.cameras[name].centre_world - camera.centre_world
        for name, camera in exposure.rig.cameras.items()
    }
    moved_ones = {name for name, shift in shifts.items() if np.linalg.norm(shift) > 1e-6}
    (pair,) = (names for names in exposure.rig.pair_names.values() if set(names) == moved_ones)
    assert shifts[pair[0]] == pytest.approx(shifts[pair[1]], abs=1e-9)
    assert np.linalg.norm(shifts[pair[0]]) == pytest.approx(2.0, abs=1e-9)


@pytest.mark.parametrize(("how", "roll_deg"), [("upside-down", 180), ("portrait-left", 90), ("portrait-right", -90)])
def test_mounted_cameras_see_the_same_rolled(how, roll_deg):
    plain, exposure = exposed(""), exposed(f"mounted={how}")
    points = np.random.default_rng(1).uniform(-80.0, 80.0, (30, 3))
    angle = math.radians(roll_deg)
    roll = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    for name, camera in plain.rig.cameras.items():
        before = camera.camera_from_world.apply(points)
        after = exposure.rig.cameras[name].camera_from_world.apply(points)
        assert after[:, :2] == pytest.approx(before[:, :2] @ roll.T, abs=1e-9)
        assert after[:, 2] == pytest.approx(before[:, 2], abs=1e-9)
    if how == "upside-down":
        for pair in exposure.rig.pairs:  # the right camera still is to the right in the left one's picture
            right_in_left = pair.left.camera_from_world.apply(pair.right.centre_world[None])[0]
            assert right_in_left[0] > abs(right_in_left[1])


def test_pairs_fire_one_after_another_and_cameras_of_a_pair_together():
    exposure = exposed("asynchronous=120")
    moments = [exposure.seconds[left] for left, _ in exposure.rig.pair_names.values()]
    assert all(exposure.seconds[left] == exposure.seconds[right] for left, right in exposure.rig.pair_names.values())
    assert sorted(moments) == pytest.approx([-0.06, -0.02, 0.02, 0.06])
    chest = np.zeros((1, 3))
    furthest = max(exposure.shift_mm(name, chest)[0] for name in exposure.rig.cameras)
    assert 0.05 < furthest < 0.06 * 20.0  # mm: sway and breath, each below 10 mm/s


def test_pairs_see_the_chest_at_other_moments_of_a_breath():
    exposure = exposed("breathing=0.8")
    at = np.array([[0.0, 0.0, 0.0], [0.0, -400.0, 0.0]])
    assert exposure.motion is not None
    chest, belly = np.array(
        [exposure.motion.at(at, exposure.seconds[left]) - at for left, _ in exposure.rig.pair_names.values()]
    ).transpose(1, 0, 2)
    assert np.linalg.norm(chest.max(axis=0) - chest.min(axis=0)) == pytest.approx(0.8)
    assert np.abs(belly).max() < 0.02


def test_motion_turns_as_a_rotation_does():
    turn = np.array([0.001, -0.002, 0.0015])
    motion = SubjectMotion(
        sway_mm_s=np.array([1.0, 2.0, 3.0]), turn_rad_s=turn, breath_mm_s=np.zeros(3), chest=np.zeros(3)
    )
    points = np.random.default_rng(2).uniform(-200.0, 200.0, (50, 3))
    expected = Rotation.from_rotvec(0.5 * turn).apply(points) + 0.5 * np.array([1.0, 2.0, 3.0])
    assert motion.at(points, 0.5) == pytest.approx(expected, abs=350.0 * (0.5 * 0.0027) ** 2)  # second order
    breathing = SubjectMotion(
        sway_mm_s=np.zeros(3), turn_rad_s=np.zeros(3), breath_mm_s=np.array([0.0, 0.0, 8.0]), chest=np.zeros(3)
    )
    far = np.array([[0.0, 0.0, 0.0], [0.0, -400.0, 0.0]])
    assert (breathing.at(far, 0.1) - far)[:, 2] == pytest.approx([0.8, 0.0], abs=0.01)


@pytest.mark.slow
def test_a_moved_subject_takes_its_paint_along():
    camera = make_rig("reference:front", 0.06, 3).cameras["front_left"]
    skin = SkinReflectance(contrast=0.12)
    scene = light_scene(sphere(60.0, 2.0), rig_from_solid(sphere(60.0, 20.0), 1), flashes(), skin=skin)
    shift = np.array([2.5, -1.0, 0.0])
    motion = SubjectMotion(sway_mm_s=10.0 * shift, turn_rad_s=np.zeros(3), breath_mm_s=np.zeros(3), chest=np.zeros(3))
    there = render_subject(moved(scene, motion, 0.1), camera, skin, seed=4)
    # A camera that moves the other way sees the same, but for the light: 2.5 mm of 900 mm.
    same = render_subject(scene, shifted(camera, -shift), skin, seed=4)
    stayed = render_subject(scene, camera, skin, seed=4)
    lit = (there.mean(axis=2) > 0.1) & (same.mean(axis=2) > 0.1) & (stayed.mean(axis=2) > 0.1)
    assert lit.sum() > 2000
    off = np.abs(there - same)[lit] / there[lit].mean()
    assert np.percentile(off, 95) < 0.02
    assert np.median(off) < 0.2 * np.median(np.abs(there - stayed)[lit] / there[lit].mean())


def test_films_differ_as_asked():
    plain, exposure = exposed(""), exposed("exposures=0.2,white-balance=0.1,out-of-focus=3,jpeg=80,flash-failed=2")
    gains = np.array([film.gain_rgb for film in exposure.films.values()])
    assert np.ptp(gains[:, 1]) > 0.1
    assert np.ptp(gains[:, 0] / gains[:, 1]) > 0.03
    assert sum(film.blur_px != 0.5 for film in exposure.films.values()) == 1
    assert all(film.chroma_halved and film.jpeg_quality == 80 for film in exposure.films.values())
    assert exposure.lights[1, 3] == 0.0
    assert np.array_equal(np.delete(exposure.lights, 1, axis=0), np.delete(plain.lights, 1, axis=0))


@pytest.mark.parametrize("scale", [0.15, 1.0])
def test_what_a_lens_does_is_a_share_of_the_picture(scale):
    exposure = exposed("out-of-focus=6,aberration=0.001", scale=scale)
    blurs = sorted(film.blur_px for film in exposure.films.values())
    assert blurs[:7] == [0.5] * 7
    assert math.sqrt(blurs[7] ** 2 - 0.5**2) == pytest.approx(6.0 * scale, rel=1e-3)  # the same angle
    width = round(4504 * scale)
    row = np.zeros((3, width), dtype=np.float32)
    place = width // 2 + width // 4
    row[:, place] = 1.0
    red = magnified(row, exposure.films["front_left"].aberration[0])[1]
    moved = red @ np.arange(width) / red.sum() - place
    assert moved == pytest.approx(0.001 * (place - 0.5 * (width - 1)), abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in _NAMES if DISTURBANCES[name].stage == "thing"])
def test_things_are_sound_meshes_outside_the_body(name):
    solid = operated("skin")
    about = Surroundings(solid=solid, rig_from_solid=rig_from_solid(solid, 7), skin=SKINS["skin"])
    kind = DISTURBANCES[name]
    sizes = kind.size.words if isinstance(kind.size, Word) else tuple(f"{size:g}" for size in kind.size.within)
    for size in ("", *sizes):
        found: Surroundings = disturbed(about, "thing", parse_situation(f"{name}={size}"), 7)
        assert found.things
        for thing in found.things:
            props = thing.props
            assert np.isfinite(props.vertices).all()
            assert np.linalg.norm(props.normals, axis=1) == pytest.approx(1.0, abs=1e-6)
            assert props.faces.max() < len(props.vertices)
            assert len(thing.colours) > props.material.max()
            # Faces look where their normals do: what is lit is what is seen.
            corners = props.vertices[props.faces]
            face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            assert ((face * props.normals[props.faces].mean(axis=1)).sum(axis=1) >= 0).mean() > 0.99
    again: Surroundings = disturbed(about, "thing", parse_situation(name), 7)
    others = ",".join(sorted({"band", "mat", "window"} - {name}))
    beside: Surroundings = disturbed(about, "thing", parse_situation(f"{name},{others}"), 7)
    assert any(np.array_equal(again.things[0].props.vertices, thing.props.vertices) for thing in beside.things)


def test_shapes_of_things_have_their_volumes():
    radius, length = 12.0, 300.0
    rod = merged([bar(straight((0.0, 0.0, 0.0), (length, 0.0, 0.0)), radius, 64)])
    assert rod.is_watertight()
    prism = 0.5 * 64 * math.sin(2 * math.pi / 64) * radius**2 * length  # on a regular polygon
    assert rod.volume_mm3() == pytest.approx(prism, rel=1e-6)
    assert merged([box((1.0, 2.0, 3.0), (40.0, 50.0, 60.0))]).volume_mm3() == pytest.approx(120000.0, rel=1e-9)
    assert merged([ball((5.0, 0.0, 0.0), 10.0)]).volume_mm3() == pytest.approx(4188.8, rel=0.05)


@pytest.mark.slow
def test_a_rail_hides_skin_and_throws_a_shadow():
    solid = operated("skin")
    placed = rig_from_solid(solid, 7)
    about = Surroundings(solid=solid, rig_from_solid=placed, skin=SKINS["skin"])
    things = disturbed(about, "thing", parse_situation("rail=-60"), 7).things
    with_rail, without = (light_scene(solid, placed, flashes(), Room(things=them), seed=1) for them in (things, ()))
    assert with_rail.subject_faces == without.subject_faces
    skin = slice(0, without.subject_vertices)
    lost = without.attributes[skin, 8:12] - with_rail.attributes[skin, 8:12]  # share of each flash that is seen
    assert lost.min() >= 0.0
    assert (lost.max(axis=1) > 0.5).mean() > 0.005
    camera = make_rig("reference", 0.05, 3).cameras["front_left"]
    row, column = np.mgrid[0 : camera.size_wh[1] : 3, 0 : camera.size_wh[0] : 3]
    rays = camera.rays_world(np.stack([column.ravel(), row.ravel()], axis=1).astype(float)).astype(np.float32)
    start = np.broadcast_to(camera.centre_world.astype(np.float32), rays.shape).copy()
    seen = [scene.rays.run(start, rays, output=True)["primID"] for scene in (with_rail, without)]
    hidden = (seen[0] >= with_rail.subject_faces) & (seen[1] >= 0)
    assert hidden.mean() > 0.02


@pytest.mark.parametrize("text", ["nothing", "rail=5000", "removed=both", "rail,rail", "drift=much"])
def test_what_cannot_be_is_refused(text):
    with pytest.raises(ValueError, match=r"rail|drift|removed|disturbances"):
        check(parse_situation(text))


def test_draw_is_by_seed_and_grows_with_the_difficulty():
    for seed in range(30):
        drawn = [draw(seed, difficulty) for difficulty in range(4)]
        assert drawn == [draw(seed, difficulty) for difficulty in range(4)]
        stages = [[DISTURBANCES[one.name].stage for one in situation.disturbances] for situation in drawn]
        assert not {"thing", "shoot"} & set(stages[0])
        patients = [
            [one for one in situation.disturbances if DISTURBANCES[one.name].stage in ("patient", "skin")]
            for situation in drawn
        ]
        assert all(patient == patients[0] for patient in patients)
        for situation in drawn:
            check(situation)
            assert parse_situation(str(situation)) == situation
    number = [np.mean([len(draw(seed, d).disturbances) for seed in range(60)]) for d in range(4)]
    assert number == sorted(number)
    assert number[3] > number[0] + 5
    assert len({str(draw(seed, 2)) for seed in range(60)}) == 60


def test_every_disturbance_is_drawn_by_some_seed_for_development():
    names = {
        one.name for seed in range(400) if not is_held_out(seed) for d in (2, 3) for one in draw(seed, d).disturbances
    }
    of_rigs = {name for name, kind in DISTURBANCES.items() if kind.stage != "walk"}
    assert names == of_rigs - {
        "posture",
        "hanging",
        *OF_OTHER_CAPTURES,
    }  # before a rig everybody leans: scans have other postures, in which breasts hang over the fold


def test_the_page_lists_every_disturbance(repository):
    page = (repository / "docs" / "reference" / "disturbances.md").read_text(encoding="utf-8")
    for name, kind in DISTURBANCES.items():
        assert f"| `{name}` | {kind.what} |" in page


def test_a_third_of_the_seeds_is_held_out():
    assert [seed for seed in range(9) if is_held_out(seed)] == [2, 5, 8]


def test_soft_focus_blurs_every_camera_by_the_same_share_of_the_picture():
    films = exposed("soft-focus=9").films.values()
    assert {round(film.blur_px, 3) for film in films} == {round(math.hypot(0.5, 9.0 * 225 / 4504), 3)}


@pytest.mark.parametrize(("texture", "colours"), [("plain", 1), ("speckled", 3), ("patterned", 2)])
def test_a_board_lies_close_under_a_cast_and_has_its_texture(texture: str, colours: int):
    solid = make_subject("plaster_100cc", 7, edge_mm=4.0)
    placed = rig_from_solid(solid, 7)
    about: Surroundings = disturbed(
        Surroundings(solid=solid, rig_from_solid=placed, skin=SKINS["skin"]),
        "thing",
        parse_situation(f"board={texture}"),
        7,
    )
    (board,) = about.things
    up = board.props.normals[0]
    heights = placed.apply(solid.mesh.vertices) @ up - board.props.vertices[0] @ up
    assert heights.min() == pytest.approx(0.4, abs=1e-3)
    assert up == pytest.approx(placed.rotation[:, 2], abs=1e-9)
    # Two triangles of a cell have one colour.
    assert np.array_equal(*np.split(board.props.material, 2))
    assert len(board.colours) == len(np.unique(board.props.material)) == colours


def test_a_table_is_level_below_a_body_and_behind_a_cast():
    for name, kind in (("figure", "surface"), ("plaster_2", "model")):
        solid = make_subject(name, 7, edge_mm=4.0)
        assert solid.subject_kind == kind
        placed = rig_from_solid(solid, 7)
        about: Surroundings = disturbed(
            Surroundings(solid=solid, rig_from_solid=placed, skin=SKINS["skin"]), "thing", parse_situation("table"), 7
        )
        (table,) = about.things
        up = table.props.normals[0]
        heights = placed.apply(solid.mesh.vertices) @ up - table.props.vertices[0] @ up
        assert 0.0 < heights.min() < 2.0
        assert up == pytest.approx([0.0, 1.0, 0.0] if kind == "surface" else placed.rotation[:, 2], abs=1e-9)
