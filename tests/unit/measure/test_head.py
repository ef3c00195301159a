"""Where the head is, as the body shows it: four signs, and what is made of them."""

from dataclasses import replace

import numpy as np
import pytest

from mammometry.base.errors import MeasureError
from mammometry.measure.trunk.head import HeadSigns, check_head, head_signs
from mammometry.measure.trunk.thorax import SkinSamples, Trunk, find_trunk

TRUNK = Trunk(frame=np.eye(3), origin=np.zeros(3), half_width_mm=130.0)
OVER = np.diag([-1.0, -1.0, 1.0])
NOTHING = HeadSigns(arms=0.0, breasts=0.0, flanks=0.0, front=0.0)


def skin_of(points: np.ndarray, normals: np.ndarray) -> SkinSamples:
    return SkinSamples(points_world=points, normals_world=normals / np.linalg.norm(normals, axis=1, keepdims=True))


def arms(low: float, high: float, count: int = 900) -> SkinSamples:
    """Skin 1.2 to 1.6 half widths aside, evenly from one height to another."""
    rng = np.random.default_rng(0)
    aside, heights = rng.choice([-1, 1], count) * rng.uniform(155, 210, count), rng.uniform(low, high, count)
    return skin_of(np.stack([aside, heights, 0 * aside], axis=1), np.tile([0.0, 0.0, 1.0], (count, 1)))


def flanks(low: float, high: float) -> SkinSamples:
    """Skin of the trunk that faces aside."""
    rng = np.random.default_rng(1)
    side = rng.choice([-1.0, 1.0], 1200)
    points = np.stack([side * 128, rng.uniform(low, high, 1200), rng.uniform(-40, 20, 1200)], axis=1)
    return skin_of(points, np.stack([side, 0 * side, 0 * side], axis=1))


def midline(above: float, below: float, low: float = -200.0, high: float = 200.0) -> SkinSamples:
    """A strip that slopes back by these sines: towards the head above, towards the feet below."""
    rng = np.random.default_rng(2)
    y = rng.uniform(low, high, 4000)
    up = np.where(y > 0, above, -below)
    points = np.stack([rng.uniform(-15, 15, 4000), y, 100 - np.abs(y) * np.where(y > 0, above, below)], axis=1)
    return skin_of(points, np.stack([0 * y, up, np.sqrt(1 - up**2)], axis=1))


def both(*skins: SkinSamples) -> SkinSamples:
    return SkinSamples(
        points_world=np.concatenate([one.points_world for one in skins]),
        normals_world=np.concatenate([one.normals_world for one in skins]),
    )


@pytest.mark.parametrize(
    ("skin", "sign"),
    [
        (arms(80, 200), "arms"),
        (both(flanks(-180, 60), midline(0.0, 0.0)), "flanks"),
        (midline(0.35, 0.05), "front"),
        (midline(0.3, -0.2), "front"),  # a belly that stands out
    ],
)
def test_each_sign_shows_the_head_and_turns_with_the_body(skin: SkinSamples, sign: str) -> None:
    upright, over = (head_signs(skin, replace(TRUNK, frame=frame), []) for frame in (np.eye(3), OVER))
    assert getattr(upright, sign) > 0.3
    assert getattr(over, sign) == pytest.approx(-getattr(upright, sign), abs=1e-9)
    assert upright.together == pytest.approx(getattr(upright, sign))  # the others say nothing
    ends = ("below", "above") if sign == "flanks" else ("above", "below")
    assert upright.words().endswith(ends[0])
    assert over.words().endswith(ends[1])


def test_arms_that_hang_say_nothing() -> None:
    """Seen from the shoulders to the hands, more of them below."""
    assert head_signs(arms(-250, 110), TRUNK, []).arms == 0


def test_a_thing_beside_a_body_without_arms_is_no_arm() -> None:
    """Fifteen in a thousand of what was measured, below: a shelf's edge had an upright woman refused."""
    beside = both(midline(0.0, 0.0), *[midline(0.0, 0.0)] * 4, arms(-180, -120, count=300))
    assert head_signs(beside, TRUNK, []).arms == 0


def test_where_pictures_end_shows_no_head() -> None:
    """Flanks without arms, seen from far above to just below the breasts."""
    cropped = both(flanks(-70, 200), midline(0.0, 0.0, low=-70, high=200))
    assert head_signs(cropped, TRUNK, []).flanks == pytest.approx(0.0, abs=0.1)


def test_how_much_was_pictured_does_not_move_the_fronts_sign() -> None:
    """A belly that was pictured far down, and no neck: only what is seen at both ends counts."""
    near = head_signs(midline(0.25, 0.1, low=-120, high=120), TRUNK, []).front
    far = head_signs(midline(0.25, 0.1, low=-230, high=120), TRUNK, []).front
    assert near == pytest.approx(far, abs=0.02)
    assert near == pytest.approx(0.5 * 0.15 / 0.2, abs=0.02)
    assert head_signs(midline(0.25, 0.1, low=-230, high=50), TRUNK, []).front == 0  # too little above


def test_a_mound_beside_a_breast_says_nothing() -> None:
    nobody = skin_of(np.zeros((5, 3)), np.ones((5, 3)))
    assert head_signs(nobody, TRUNK, [0.8, -0.1]).breasts == pytest.approx(0.8)
    assert head_signs(nobody, TRUNK, [0.1, -0.8]).breasts == pytest.approx(-0.8)
    assert head_signs(nobody, TRUNK, []) == NOTHING


def test_what_is_said_of_the_head() -> None:
    assert check_head(replace(NOTHING, arms=1.0)).is_shown
    assert not check_head(NOTHING).is_shown
    assert "sides" in check_head(replace(NOTHING, flanks=0.7)).words
    assert not check_head(replace(NOTHING, flanks=-0.3)).is_shown
    with pytest.raises(MeasureError, match=r"^torso: .*head .*rig\.mounting"):
        check_head(replace(NOTHING, front=-0.4, breasts=-0.3))
    # What the user said of the head counts more.
    said = check_head(replace(NOTHING, front=-0.4, breasts=-0.3), stated=True)
    assert said.is_shown
    assert "head" in said.words
    # Arms that hang, of which cameras on their sides see only the lower ends, do not refuse an upright body.
    assert not check_head(HeadSigns(arms=-1.0, breasts=0.0, flanks=0.9, front=0.4)).is_shown


def test_an_arm_on_one_side_alone_does_not_move_the_trunks_axis() -> None:
    """It was the middle between the outermost skin: 100 mm aside, where both flanks lie on one side of it."""
    theta, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1.9, 1.9, 160), np.linspace(-75, 75, 60)))
    out = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    trunk = skin_of(out * [140, 0, 100] + np.stack([0 * y, y, 0 * y], axis=1), out)
    rng = np.random.default_rng(3)
    arm = np.stack([-rng.uniform(160, 420, 600), rng.uniform(-40, 20, 600), rng.uniform(0, 30, 600)], axis=1)
    found = find_trunk(both(trunk, skin_of(arm, np.tile([0.0, 0.3, 1.0], (600, 1)))), np.eye(3))
    assert not found.assumed
    assert abs(found.origin[0]) < 5.0
    assert found.half_width_mm == pytest.approx(138, abs=5)
    # Where the mid-sagittal plane is known, it decides.
    front = trunk.chosen(np.abs(theta) < 1.0)
    known = find_trunk(front, np.eye(3), middle_of=np.array([12.0, 0.0, 0.0]))
    assert known.assumed
    assert known.origin[0] == pytest.approx(12.0)
