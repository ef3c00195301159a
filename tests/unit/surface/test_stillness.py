"""What moved after the calibration is found from what pairs say of one another, named, and put right."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from moving_rig import RADII, calibrated_rig, measured, standing

from mammometry.base.errors import MammometryError, MatchingError, SurfaceError
from mammometry.base.notices import Notice
from mammometry.base.photograph import Photograph
from mammometry.calibration.judge.pose_motion import shifts
from mammometry.geometry.twist import rigid_motions
from mammometry.job.stages import surface as stages
from mammometry.surface.motion import agreement
from mammometry.surface.motion import motion_detection as stillness
from mammometry.surface.motion import rigid_motion as motions
from mammometry.surface.motion.agreement import differences
from mammometry.surface.motion.motion_detection import concerns, find, summary
from mammometry.surface.motion.moved_images import retriangulated
from mammometry.surface.motion.rigid_motion import Observed, most_probable, motion_parameters
from mammometry.surface.settings import StillnessSettings

RIG = calibrated_rig()
NOISE_MM = 0.04  # what clean captures' cells scatter by


def capture(turns_rad=None, shifts_mm=None, *, noise_mm=NOISE_MM, seed=0, radii=None):
    stood = standing(RIG, turns_rad, shifts_mm)
    both = {
        pair: measured(RIG, stood, pair, noise_mm=noise_mm, seed=seed, radii=(radii or {}).get(pair, RADII))
        for pair in RIG.pair_names
    }
    return stood, [image for image, _ in both.values()], {pair: rows for pair, (_, rows) in both.items()}


def off_mm(found, images):
    """RMS height of the carried points over the true body, what moves all together taken off."""
    points = np.concatenate([found.apply_motion(image, RIG).valid_points_world()[::7] for image in images])
    scaled = points / RADII
    gradient = scaled / RADII
    height = (np.linalg.norm(scaled, axis=1) - 1) * np.linalg.norm(scaled, axis=1) / np.linalg.norm(gradient, axis=1)
    normals = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    together = np.einsum("ni,nip->np", normals, rigid_motions(points))
    left = height - together @ np.linalg.lstsq(together, height, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


@pytest.fixture(scope="module")
def still():
    _, images, rows = capture()
    return find(RIG, images, rows), images


@pytest.fixture(scope="module")
def turned():
    rng = np.random.default_rng(3)
    turns = {name: np.radians(0.02) * _unit(rng) for name in RIG.cameras}
    _, images, rows = capture(turns)
    return find(RIG, images, rows), images, rows


def _unit(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def test_shifts_are_the_derivatives_of_what_is_measured():
    """Against pictures taken by moved cameras and intersected by solving for both distances."""
    step = 1e-5
    for name in ("front_l", "front_r"):
        for axis in range(3):
            turn = step * np.eye(3)[axis]
            image, rows = measured(RIG, standing(RIG, {name: turn}), "front")
            true, _ = measured(RIG, RIG, "front")
            effect = shifts(RIG.pair("front"), rows.points, (f"{name}.rotation_{'xyz'[axis]}_rad",))
            # turned cameras see other points of the plane: up to a thousandth of the turn
            np.testing.assert_allclose(rows.angle_rad, effect.vertical_rad[:, 0] * step, atol=2e-3 * step)
            uv = RIG.cameras["front_l"].project(rows.points)
            row, column = np.rint(uv[:, ::-1]).astype(int).T
            both = image.valid[row, column] & true.valid[row, column]
            normals = rows.points / np.square(RADII)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            ray = RIG.cameras["front_l"].rays_world(uv)
            measured_mm = image.range_mm[row, column].astype(float) - true.range_mm[row, column]
            # measured points lie on the believed left ray; true ones on the same surface, wherever they are along it
            expected = np.einsum("ni,ni->n", normals, effect.points_mm[:, :, 0]) / np.einsum("ni,ni->n", normals, ray)
            away = np.abs(np.einsum("ni,ni->n", normals, ray)) > 0.3
            # float32 ranges of 400 mm are good to 3e-5 mm; effects are some 4e-3 mm
            np.testing.assert_allclose(-measured_mm[both & away], expected[both & away] * step, atol=5e-5)


def test_carried_data_are_those_that_the_cameras_would_have_measured():
    stood = standing(RIG, {"front_l": np.array([2e-4, -3e-4, 1e-4]), "front_r": np.array([0.0, 4e-4, 0.0])})
    wrong, _ = measured(RIG, stood, "front")
    right, _ = measured(stood, stood, "front")
    found = retriangulated(wrong, RIG.pair("front"), stood.pair("front"))
    assert np.abs(wrong.range_mm - right.range_mm)[right.valid].max() > 0.1
    # rays that miss each other by a thousandth of a radian at most: second order, and float32
    assert np.abs(found.range_mm - right.range_mm)[right.valid].max() < 2e-3


def test_carrying_nowhere_changes_nothing(still):
    _, images = still
    same = retriangulated(images[0], RIG.pair("front"), RIG.pair("front"))
    np.testing.assert_allclose(same.range_mm, images[0].range_mm, rtol=1e-6)
    np.testing.assert_array_equal(same.valid, images[0].valid)


def test_differences_have_the_sign_and_size_of_a_shift():
    """A pair that believes itself 0.5 mm nearer to the body along z sees it 0.5 mm farther along z."""
    _, images, _ = capture(shifts_mm={"front": np.array([0.0, 0.0, 0.5])}, noise_mm=0.0)
    for each in differences(images):
        sign = {"front": 1.0}
        apart = (sign.get(each.first, 0.0) - sign.get(each.second, 0.0)) * -0.5 * each.normals[:, 2]
        np.testing.assert_allclose(each.distance_mm, apart, atol=0.03)  # ranges between pixels of 1 mm, on curved skin


def test_differences_are_those_of_each_cell_alone():
    """Plain twin: one cell after the other."""
    rng = np.random.default_rng(0)
    count = 3000
    points = rng.uniform(-40.0, 40.0, (count, 3))
    normals = rng.normal(size=(count, 3)) + np.array([0.0, 0.0, 5.0])
    apart, sigma = rng.normal(size=count), rng.uniform(0.1, 0.2, count)
    found = agreement._in_cells("a", "b", points, normals, apart, sigma)
    cells = {}
    for index, place in enumerate(np.floor(points / agreement._CELL_MM).astype(int).tolist()):
        cells.setdefault(tuple(place), []).append(index)
    kept = [cells[place] for place in sorted(cells) if len(cells[place]) >= agreement._FEWEST_DATA]
    assert len(kept) < len(cells)
    for row, cell in enumerate(kept):
        np.testing.assert_allclose(found.points[row], points[cell].mean(axis=0), atol=1e-12)
        mean = normals[cell].mean(axis=0)
        np.testing.assert_allclose(found.normals[row], mean / np.linalg.norm(mean), atol=1e-12)
        assert found.distance_mm[row] == np.median(apart[cell])
        assert found.expected_mm[row] == np.median(sigma[cell])
        scatter = agreement._MEDIAN_FACTOR * apart[cell].std() / np.sqrt(len(cell))
        assert found.scatter_mm[row] == pytest.approx(scatter, rel=1e-12)
    assert len(found.points) == len(kept)
    assert agreement._in_cells("a", "b", points[:5], normals[:5], apart[:5], sigma[:5]) is None


def test_a_still_capture_is_left_alone(still):
    found, images = still
    assert found.compared
    assert not found.moved
    assert found.apply_motion(images[0], RIG) is images[0]
    assert found.rig(RIG) is RIG
    assert not list(concerns(found))
    assert "nothing" in summary(found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.requirement("R-CAL-2")
def test_no_false_alarm(seed):
    _, images, rows = capture(seed=seed + 10, noise_mm=1.5 * NOISE_MM)
    assert not find(RIG, images, rows).moved


@pytest.mark.slow
@pytest.mark.parametrize("moves", [False, True])
def test_rows_that_no_motion_explains_move_nothing(still, turned, moves):
    """Much of one pair was matched by chance: its rows miss one another by a pixel, here and there."""
    images, rows = (turned if moves else (*still, capture()[2]))[1:]
    pair = next(iter(rows))
    by_chance = np.random.default_rng(5).normal(0.0, 1.2 * rows[pair].pixel_rad, len(rows[pair].points))
    spoilt = replace(rows[pair], angle_rad=rows[pair].angle_rad + by_chance)
    found = find(RIG, images, {**rows, pair: spoilt})
    assert found.corrected == moves
    if moves:
        assert off_mm(found, images) < 0.5 * off_mm(replace(found, corrected=False), images)


def test_rows_that_common_skin_contradicts_move_nothing(still):
    """One pair's rows miss one another more and more towards one side, as if a camera had turned; no skin is apart."""
    _, images = still
    rows = capture()[2]
    pair = next(iter(rows))
    aside = rows[pair].points[:, 1] - rows[pair].points[:, 1].min()
    ramp = 1.2 * rows[pair].pixel_rad * (aside / aside.max()) ** 2
    spoilt = replace(rows[pair], angle_rad=rows[pair].angle_rad + ramp)
    assert not find(RIG, images, {**rows, pair: spoilt}).moved


@pytest.mark.requirement("R-CAL-2")
def test_turned_cameras_are_put_right(turned):
    found, images, _ = turned
    assert found.corrected
    assert found.distance_mm[1] < 0.5 * found.distance_mm[0]
    before, after = off_mm(replace(found, corrected=False), images), off_mm(found, images)
    assert before > 2 * NOISE_MM
    assert after < max(0.4 * before, 1.5 * NOISE_MM)


@pytest.mark.slow
def test_what_is_left_is_as_large_as_claimed():
    """Over many draws the corrected points lie off by what the covariance says, within a factor of two."""
    ratios = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        turns = {name: np.radians(0.02) * _unit(rng) for name in RIG.cameras}
        stood, images, rows = capture(turns, seed=seed)
        found = find(RIG, images, rows)
        if not found.moved:  # turns that displace all pairs alike are no matter
            continue
        claimed = np.sqrt(np.mean([each.std_mm**2 for each in found.displaced]))
        points = [image.valid_points_world()[::50] for image in images]
        true = [
            retriangulated(image, RIG.pair(image.name), stood.pair(image.name)).valid_points_world()[::50]
            for image in images
        ]
        ours = [found.apply_motion(image, RIG).valid_points_world()[::50] for image in images]
        away = np.concatenate(ours) - np.concatenate(true)
        whole = np.concatenate(points)
        together = rigid_motions(whole - whole.mean(axis=0)).reshape(-1, 6)
        left = away.ravel() - together @ np.linalg.lstsq(together, away.ravel(), rcond=None)[0]
        ratios.append(np.sqrt(np.mean(left**2) * 3) / claimed)
    assert len(ratios) >= 2
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 1.5


@pytest.mark.slow
@pytest.mark.requirement("R-CAL-2")
def test_one_camera_that_turned_is_named():
    _, images, rows = capture({"left_r": np.array([0.0, np.radians(0.06), 0.0])})
    found = find(RIG, images, rows)
    assert found.alone == "left_r"
    assert [each.camera for each in found.turns] == ["left_r"]
    assert found.turns[0].turn_deg == pytest.approx(0.06, rel=0.35)
    assert found.displaced[0].pair == "left"
    assert "left_r" in {name for notice in concerns(found) for name in notice.about}
    drawn_first, corrected = concerns(found, {"left": ("left_r",)})
    assert (drawn_first.code, drawn_first.about) == ("outline-first", ("left_r",))
    assert (corrected.code, corrected.about) == ("motion-corrected", ("left",))
    uncertain = next(concerns(replace(found, turns=())))
    assert (uncertain.code, uncertain.about) == ("camera-turned-probably", ("left_r",))


@pytest.mark.requirement("R-CAL-3")
def test_a_body_that_moved_between_exposures_is_put_right_and_told_from_a_camera():
    _, images, rows = capture(shifts_mm={"left": np.array([0.0, 0.4, 0.9])})
    found = find(RIG, images, rows)
    assert found.corrected
    assert off_mm(found, images) < 0.5 * off_mm(replace(found, corrected=False), images)
    assert found.displaced[0].pair == "left"
    assert found.displaced[0].body_mm > 0.6 * found.displaced[0].effect_mm
    assert next(concerns(found)).code == "body-moved"


@pytest.mark.slow
def test_a_chest_that_breathed_between_exposures_is_put_right_and_said():
    """Its middle was a millimetre further out when one pair was exposed: no pair moved as a whole."""
    _, (front, *others), rows = capture()
    x, y, _ = np.moveaxis(front.points_world(), -1, 0)
    out_mm = np.exp(-(x**2 + y**2) / (2 * 50.0**2))
    front = replace(front, range_mm=np.where(front.valid, front.range_mm - out_mm, 0.0).astype(np.float32))
    found = find(RIG, [front, *others], rows)
    assert found.corrected
    assert found.breathed
    assert found.distance_mm[1] < 0.2 * found.distance_mm[0]
    assert next(concerns(found)).code == "body-breathed"
    moved = found.apply_motion(front, RIG)
    assert moved.valid.sum() > 0.95 * front.valid.sum()  # but for pixels at the edge
    carried = [
        comparison.distance_mm for comparison in differences([moved, *(found.apply_motion(one, RIG) for one in others)])
    ]
    assert np.sqrt(np.mean(np.concatenate(carried) ** 2)) == pytest.approx(found.distance_mm[1], rel=0.3)


@pytest.mark.slow
def test_a_body_that_ripples_is_not_explained_and_refused_beyond_the_limit(monkeypatch):
    """Waves of some ten millimetres make no smooth motion. Uncertain motions stay in the covariance."""
    _, images, rows = capture(noise_mm=0.5)
    found = find(RIG, images, rows)
    assert found.moved
    assert found.unexplained
    assert "motion-unexplained" in {notice.code for notice in concerns(found)}
    with pytest.raises(SurfaceError, match="expose"):
        find(RIG, images, rows, settings=StillnessSettings(most_unexplained_mm=0.0))
    monkeypatch.setattr(stillness, "LEAST_EVIDENCE", 1e9)
    unsure = find(RIG, images, rows)
    assert unsure.moved
    assert not unsure.corrected
    assert unsure.apply_motion(images[0], RIG) is images[0]
    assert np.linalg.eigvalsh(unsure.covariance - np.outer(unsure.motions, unsure.motions)).min() > -1e-9
    assert {notice.code for notice in concerns(unsure)} & {"motion-not-corrected", "motion-not-confirmed"}


@pytest.mark.slow
@pytest.mark.requirement("R-CAL-2")
def test_far_motions_are_refused_by_name():
    _, images, rows = capture({"right_l": np.array([0.0, np.radians(0.3), 0.0])})
    with pytest.raises(SurfaceError, match=r"^pair right.*right_l"):
        find(RIG, images, rows, settings=StillnessSettings(most_mm=1.0))


@pytest.mark.requirement("R-MASK-2")
@pytest.mark.slow
def test_missing_outlines_are_named_before_cameras_are_said_to_have_moved():
    """Where everything was matched, the pairs may disagree because one saw the background."""
    _, images, rows = capture({"right_l": np.array([0.0, np.radians(0.3), 0.0])})
    ranges, cameras = {image.name: image for image in images}, SimpleNamespace(rig=RIG)
    stopping = SimpleNamespace(surface=SimpleNamespace(stillness=StillnessSettings(most_mm=1.0)))
    plain = Photograph(name="a", pixels=np.full((150, 150), 90, np.uint8))
    inputs = SimpleNamespace(photographs=dict.fromkeys(RIG.cameras, plain), walk=None)

    def refusal(doubts):
        with pytest.raises(MammometryError) as refused:
            stages.stillness.function(
                cameras,
                None,
                ranges,
                rows,
                SimpleNamespace(doubts=doubts),
                job=SimpleNamespace(settings=stopping, inputs=inputs),
            )
        return refused.value

    missing = refusal({"front_l": "it does not fit", "front_r": ""})
    assert isinstance(missing, MatchingError)
    assert missing.subject == "capture, front_l"
    assert "masks/front_l.png" in missing.remedy
    assert "calibrate" not in str(missing)
    assert isinstance(refusal({}), SurfaceError)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least"), [("LEAST_MM", 5.0), ("LEAST_EVIDENCE", 1e6)])
def test_smaller_effects_and_weaker_evidence_are_no_motion(turned, name, least, monkeypatch):
    _, images, rows = turned
    monkeypatch.setattr(f"mammometry.surface.motion.motion_detection.{name}", least)
    assert not find(RIG, images, rows).moved


def test_pairs_without_common_skin_are_not_compared():
    image, rows = measured(RIG, RIG, "front")
    found = find(RIG, [image], {"front": rows})
    assert not found.compared
    assert not found.moved
    assert "compared" in summary(found)


@pytest.mark.slow
def test_a_pair_that_no_other_sees_moves_by_as_much_as_the_others_for_all_we_know():
    rng = np.random.default_rng(3)
    _, images, rows = capture({name: np.radians(0.08) * _unit(rng) for name in RIG.cameras})
    alone = [image if image.name != "right" else image.keeping(np.zeros_like(image.valid)) for image in images]
    found = find(RIG, alone, rows)
    std_mm = {each.pair: each.std_mm for each in found.displaced}
    assert std_mm["right"] > 1.5 * std_mm["left"]


def test_pairs_that_share_a_camera_move_together():
    shared = replace(RIG, pair_names={**RIG.pair_names, "across": ("front_r", "right_l")})
    asked = motion_parameters(shared, list(shared.pair_names), np.zeros(3))
    assert sorted(sorted(group) for group in asked.groups) == [["across", "front", "right"], ["left"]]
    assert asked.count == 3 * 6 + 6 * 2
    assert asked.of_group("front") == asked.of_group("across") != asked.of_group("left")


def test_the_unexplained_rest_is_said():
    found = replace(
        stillness._nothing(motion_parameters(RIG, list(RIG.pair_names), np.zeros(3))),
        moved=True,
        rest_mm=0.3,
        unexplained=True,
        displaced=(stillness.Displaced(pair="left", effect_mm=0.2, std_mm=0.1, body_mm=0.19),),
    )
    assert list(concerns(found))[-1] == Notice(code="motion-unexplained", values={"mm": 0.3})


def dense_log_evidence(seen, asked, turn_rad, shift_mm, rest_mm):
    """Of the observations by their whole covariance in one matrix, whatever is constant left out."""
    design = seen.by_unknown * asked.prior_std(turn_rad, shift_mm)
    noise = np.zeros((len(seen.values),) * 2)
    start = 0
    for block in seen.own:
        noise[start : start + len(block), start : start + len(block)] = block
        start += len(block)
    whole = noise + seen.common @ seen.common.T + np.diag(seen.distances * rest_mm**2) + design @ design.T
    sign, log_det = np.linalg.slogdet(whole)
    assert sign > 0
    return -0.5 * (log_det + seen.values @ np.linalg.solve(whole, seen.values))


def test_evidence_block_by_block_is_that_of_the_whole_covariance():
    rng = np.random.default_rng(5)
    asked = motion_parameters(RIG, list(RIG.pair_names), np.zeros(3))
    roots = [rng.normal(size=(count, count)) for count in (7, 9, 5, 4)]
    distances = np.arange(25) < 16
    seen = Observed(
        values=rng.normal(size=25),
        by_unknown=rng.normal(size=(25, asked.count)) * asked.prior_std(1e-3, 0.1) ** -1,
        own=tuple(root @ root.T + np.eye(len(root)) for root in roots),
        common=rng.normal(size=(25, 6)),
        distances=distances,
        rows_of=np.repeat([-1, 0, 1], [16, 5, 4]),
    )
    found = most_probable(seen, asked)
    rests, still = motions._RESTS_MM, found.still
    assert still.log_evidence - dense_log_evidence(seen, asked, 0.0, 0.0, found.still_rest_mm) == pytest.approx(
        0.0, abs=1e-8
    )
    best = max(
        dense_log_evidence(seen, asked, turn, shift, rest)
        for turn in np.radians(motions._TURNS_DEG)
        for shift in motions._SHIFTS_MM
        for rest in rests
    )
    assert found.expected.log_evidence == pytest.approx(best, abs=1e-8)
