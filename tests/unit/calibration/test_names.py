"""Photographs under wrong names, of another patient or rig, by features of known points."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from mammometry.base.errors import MatchingError
from mammometry.calibration.features.keypoints import Keypoints, matched
from mammometry.calibration.judge.camera_names import check_names, wrong_photographs
from mammometry.calibration.judge.expected_error import meeting_point
from mammometry.geometry.camera import Rig
from mammometry.geometry.transform import Transform
from mammometry.job.stages import match
from mammometry.simulate.rigs.build import REFERENCE, build_rig

POINTS, NOISE_PX = 250, 0.3  # of a subject; of a feature's place


def photographs(rig, seed=1, *, points=POINTS, strangers=100):
    """Camera → features of one subject that its pair's cameras share, and of things that nobody else sees."""
    rng = np.random.default_rng(seed)
    seen = {}
    for both in rig.pair_names.values():
        skin = meeting_point(rig) + rng.normal(0.0, 45.0, (points, 3))
        words = rng.normal(size=(points, 128))
        for name in both:
            camera = rig.cameras[name]
            uv = camera.project(skin) + rng.normal(0.0, NOISE_PX, (points, 2))
            other = rng.uniform((0, 0), camera.size_wh, (strangers, 2))
            descriptors = np.concatenate([words, rng.normal(size=(strangers, 128))])
            if name not in seen:
                seen[name] = Keypoints(uv=np.concatenate([uv, other]), descriptors=descriptors.astype(np.float32))
    return seen


@pytest.fixture(scope="module")
def rig():
    return build_rig(REFERENCE, 0.25, 3)


@pytest.fixture(scope="module")
def seen(rig):
    return photographs(rig)


def test_right_names_are_left_alone(rig, seen):
    names = check_names(rig, seen)
    assert names.right
    assert not names.unknown
    assert list(wrong_photographs(names, rig.pair_names)) == []


@pytest.mark.requirement("R-FIRE-5")
def test_any_two_photographs_that_are_exchanged_are_named(rig, seen):
    for one, other in list(combinations(rig.cameras, 2))[::4]:
        names = check_names(rig, {**seen, one: seen[other], other: seen[one]})
        assert names.exchanged == {one: other, other: one}, (one, other)
        (wrong,) = wrong_photographs(names, rig.pair_names)
        assert set(wrong.cameras) == {one, other}
        assert "exchanged" in wrong.found


def test_two_pairs_that_are_exchanged_are_named(rig, seen):
    (one, other), (third, fourth) = (rig.pair_names[pair] for pair in ("front", "left"))
    mixed = {**seen, one: seen[third], other: seen[fourth], third: seen[one], fourth: seen[other]}
    names = check_names(rig, mixed)
    assert names.exchanged == {one: third, third: one, other: fourth, fourth: other}
    assert {frozenset(cycle) for cycle in names.cycles} == {frozenset((one, third)), frozenset((other, fourth))}


def test_one_refusal_names_all_photographs_that_are_exchanged(rig, seen, monkeypatch):
    monkeypatch.setattr("mammometry.calibration.features.keypoints.keypoints", lambda photograph: photograph.features)
    (one, other), (third, fourth) = (rig.pair_names[pair] for pair in ("front", "left"))
    shown = {**seen, one: seen[third], other: seen[fourth], third: seen[one], fourth: seen[other]}
    photographs = {
        name: SimpleNamespace(pixels=np.empty(rig.cameras[name].size_wh[::-1]), features=shown[name]) for name in shown
    }
    inputs = SimpleNamespace(pair_names=rig.pair_names, photographs=photographs, walk=None)
    job = SimpleNamespace(inputs=inputs)
    with pytest.raises(MatchingError) as refused:
        match.names.function(SimpleNamespace(rig=rig), job=job)
    assert f"{one} and {third}; {other} and {fourth}: " in str(refused.value)


def test_two_pairs_that_nearly_mirror_one_another_are_named_when_they_are_exchanged(rig):
    """By the features of either pair under the other's name, most fit: only the comparison tells."""
    cameras = dict(rig.cameras)
    middle = meeting_point(rig)
    pairs = {pair: rig.pair_names[pair] for pair in ("left", "right")}
    half_turn = Transform.from_rotation_vector(np.array([0.0, np.pi, 0.0]), np.zeros(3))
    to_middle = Transform(rotation=np.eye(3), translation_mm=-middle)
    turn = to_middle.inverse() @ half_turn @ to_middle
    for own, its_twin, lean_deg in zip(pairs["left"], pairs["right"], (0.0, 2.5), strict=True):
        lean = Transform.from_rotation_vector(np.array([0.0, 0.0, np.deg2rad(lean_deg)]), np.zeros(3))
        camera = cameras[own]
        cameras[its_twin] = replace(camera, camera_from_world=lean @ camera.camera_from_world @ turn)
    alike = Rig(
        name="alike", cameras={name: cameras[name] for both in pairs.values() for name in both}, pair_names=pairs
    )
    seen = photographs(alike)
    assert check_names(alike, seen).right
    (one, other), (third, fourth) = pairs.values()
    mixed = {**seen, one: seen[third], other: seen[fourth], third: seen[one], fourth: seen[other]}
    names = check_names(alike, mixed)
    assert all(found.sure for found in names.pairs.values())  # by themselves nothing is wrong
    assert names.exchanged == {one: third, third: one, other: fourth, fourth: other}


@pytest.mark.requirement("R-FIRE-5")
def test_a_photograph_of_another_patient_is_found_with_its_pair(rig, seen):
    name = rig.pair_names["front"][0]
    names = check_names(rig, {**seen, name: photographs(rig, seed=2)[name]})
    assert names.unrelated == ("front",)
    (wrong,) = wrong_photographs(names, rig.pair_names)
    assert set(wrong.cameras) <= set(rig.pair_names["front"])
    assert name in wrong.cameras


def test_a_shared_camera_tells_which_photograph_is_the_foreign_one(rig, seen):
    """Two pairs with one camera in common, as cheap rigs have them."""
    left, middle = rig.pair_names["front"]
    third = rig.pair_names["floor"][0]
    shared = Rig(
        name="three",
        cameras={name: rig.cameras[name] for name in (left, middle, third)},
        pair_names={"a": (left, middle), "b": (middle, third)},
    )
    rng = np.random.default_rng(5)
    skin, words = meeting_point(shared) + rng.normal(0.0, 45.0, (POINTS, 3)), rng.normal(size=(POINTS, 128))
    own = {
        name: Keypoints(uv=camera.project(skin), descriptors=words.astype(np.float32))
        for name, camera in shared.cameras.items()
    }
    assert check_names(shared, own).right
    names = check_names(shared, {**own, left: seen[left]})
    assert names.exchanged == {}
    if names.unrelated:  # pairs of this rig are seen under angles that differ
        assert names.foreign == (left,)
    exchanged = check_names(shared, {**own, left: own[third], third: own[left]})
    assert exchanged.exchanged == {left: third, third: left}


def test_photographs_of_another_rig_are_one_sentence(rig):
    names = check_names(rig, photographs(build_rig(REFERENCE, 0.25, 8)))
    assert names.another_rig
    (wrong,) = wrong_photographs(names, rig.pair_names)
    assert "rig" in wrong.found


def test_too_little_texture_is_said_and_refuses_nothing(rig):
    names = check_names(rig, photographs(rig, points=6, strangers=20))
    assert names.right
    assert set(names.unknown) == set(rig.pair_names)


@pytest.mark.requirement("R-MASK-1")
def test_the_squares_of_a_pattern_match_nothing():
    """Fifty features that look alike, and fifty of their own kind, seen by two cameras with noise."""
    rng = np.random.default_rng(8)
    alike, unlike = np.tile(rng.uniform(0, 100, 128), (50, 1)), rng.uniform(0, 100, (50, 128))
    uv = rng.uniform(0, 400, (100, 2))
    one, other = (
        Keypoints(
            uv=uv, descriptors=(np.concatenate([alike, unlike]) + rng.normal(0, 5, (100, 128))).astype(np.float32)
        )
        for _ in range(2)
    )
    here, there = matched(one, other)
    assert np.array_equal(here, uv[50:])
    assert np.array_equal(there, uv[50:])


@pytest.mark.requirement("R-MASK-1")
def test_what_looks_alike_in_one_picture_alone_matches_nothing():
    """The other picture shows only one of the alike ones: it is nobody's second there."""
    rng = np.random.default_rng(9)
    kind, unlike = rng.uniform(0, 100, 128), rng.uniform(0, 100, (20, 128))
    many = Keypoints(
        uv=rng.uniform(0, 400, (25, 2)),
        descriptors=np.concatenate([kind + rng.normal(0, 5, (5, 128)), unlike]).astype(np.float32),
    )
    single = Keypoints(
        uv=many.uv[4:], descriptors=np.concatenate([kind + rng.normal(0, 5, (1, 128)), unlike]).astype(np.float32)
    )
    for one, other in ((many, single), (single, many)):
        assert len(matched(one, other)[0]) == len(unlike)


def pair_seen(rig, right=(), strangers=0, seed=3):
    """Features of the front pair: points of the subject, and as many others that match by chance alone."""
    rng = np.random.default_rng(seed)
    words = rng.normal(size=(len(right) + strangers, 128)).astype(np.float32)
    seen = {}
    for name in rig.pair_names["front"]:
        uv = rig.cameras[name].project(right) if len(right) else np.empty((0, 2))
        uv = uv + rng.normal(0.0, NOISE_PX, uv.shape)
        other = rng.uniform((0, 0), rig.cameras[name].size_wh, (strangers, 2))
        seen[name] = Keypoints(uv=np.concatenate([uv, other]), descriptors=words)
    return seen


@pytest.mark.parametrize(("right", "by_chance"), [(7, 23), (8, 30), (12, 80), (0, 34)])
def test_few_matches_that_fit_among_many_by_chance_refuse_nothing(rig, right, by_chance):
    """Seven of thirty are too many for chance (2e-8), and speak for the cameras; none of thirty-four says nothing."""
    rng = np.random.default_rng(4)
    skin = meeting_point(rig) + rng.normal(0.0, 45.0, (right, 3))
    names = check_names(rig, pair_seen(rig, skin, by_chance))
    assert names.pairs["front"].matches >= 30
    assert names.pairs["front"].fitting < 0.25
    assert names.right
    assert names.unknown == ("front",)


@pytest.mark.parametrize("by_chance", [0, 25])
def test_photographs_that_show_the_same_from_elsewhere_are_refused(rig, by_chance):
    """Also where a third of the matches is by chance: the others agree, but on cameras elsewhere."""
    _, right = rig.pair_names["front"]
    elsewhere = replace(rig, cameras={**rig.cameras, right: replace(rig.cameras["floor_right"], name=right)})
    rng = np.random.default_rng(4)
    skin = meeting_point(rig) + rng.normal(0.0, 45.0, (60, 3))
    names = check_names(rig, pair_seen(elsewhere, skin, by_chance))
    assert names.pairs["front"].fitting < 0.25
    assert names.misfitting == ("front",)
