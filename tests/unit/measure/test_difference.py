"""The interval of a difference, by the law of propagation worked by hand, and by drawing errors."""

from dataclasses import replace

import numpy as np
import pytest

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.volume.difference import difference
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.sources import BOUNDARY_CORRELATION, WALL_CORRELATION

TETRAHEDRON = TriangleMesh(
    vertices=np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32),
)


WALL_SHARE, BOUNDARY_SHARE = WALL_CORRELATION**0.5, BOUNDARY_CORRELATION**0.5


def breast(name: str, volume_cc: float, area_cm2: float, **terms_cc: float) -> VolumeMeasurement:
    """One side. Scale, axis and scanner are common wholly, wall and boundary in part, all else is its own."""
    shares = {"scale": 1.0, "trunk's axis": 1.0, "scanner": 1.0, "chest wall": WALL_SHARE, "boundary": BOUNDARY_SHARE}
    terms = {term.replace("_", " "): value for term, value in terms_cc.items()}
    half = float(np.sqrt(sum(value**2 for value in terms.values())))
    return VolumeMeasurement(
        name=name,  # type: ignore[arg-type]
        volume_cc=volume_cc,
        interval_cc=(volume_cc - half, volume_cc + half),
        interval_terms_cc=terms,
        common_cc={name: (shares[name] * value,) for name, value in terms.items() if name in shares},
        interval_note="",
        closed=TETRAHEDRON,
        skin_faces=3,
        watertight=True,
        wall_kind="cylinder-membrane",
        wall_definition="",
        boundary_world=TETRAHEDRON.vertices,
        boundary_method="",
        alternatives_cc={},
        base_area_cm2=area_cm2,
        projection_mm=1.0,
        area_cm2=area_cm2,
    )


LEFT_BREAST = breast("left", 400.0, 160.0, chest_wall=144.0, boundary=20.0, scale=4.0)
RIGHT_BREAST = breast("right", 300.0, 120.0, chest_wall=108.0, boundary=15.0, scale=3.0)


def test_an_axis_that_is_assumed_for_both_sides_puts_them_off_alike() -> None:
    """2.5 % of each volume, in the same direction: of what is between them 2.5 %, and of their ratio nothing."""
    left = breast("left", 400.0, 160.0, **{"trunk's axis": 10.0})
    right = breast("right", 300.0, 120.0, **{"trunk's axis": 7.5})
    found = difference(left, right, "sides")
    assert dict(found.terms_cc) == pytest.approx({"trunk's axis": 2.5})
    assert found.ratio_interval == pytest.approx((4 / 3, 4 / 3))
    alone = difference(left, breast("right", 300.0, 120.0, boundary=1.0), "across poses")
    assert alone.terms_cc["trunk's axis"] == pytest.approx(10.0)  # seen on one date: the other's is not off with it


@pytest.mark.requirement("R-VOL-11")
def test_what_both_share_falls_out() -> None:
    found = difference(LEFT_BREAST, RIGHT_BREAST, "sides")
    # By the law of propagation with correlations: √(a² + b² − 2ρab).
    assert dict(found.terms_cc) == pytest.approx(
        {
            "chest wall": np.sqrt(144**2 + 108**2 - 2 * WALL_CORRELATION * 144 * 108),
            "boundary": np.sqrt(20**2 + 15**2 - 2 * BOUNDARY_CORRELATION * 20 * 15),
            "scale": 1.0,
        }
    )
    half = np.sqrt(sum(term**2 for term in found.terms_cc.values()))
    assert found.difference_cc == 100.0
    assert found.difference_interval_cc == pytest.approx((100 - half, 100 + half))
    assert found.beyond_error is True
    relative = 0.36**2 * 2 * (1 - WALL_CORRELATION) + 0.05**2 * 2 * (1 - BOUNDARY_CORRELATION)  # the scale's is nothing
    log_half = np.sqrt(relative)
    assert found.ratio_interval == pytest.approx((4 / 3 * np.exp(-log_half), 4 / 3 * np.exp(log_half)))
    assert found.note.endswith("chest wall, boundary, scale cancels out.")


@pytest.mark.requirement("R-VOL-4")
def test_the_intervals_hold_drawn_errors_at_their_rate() -> None:
    """Errors drawn as the model has them: one scale, and of wall and boundary a share for both and one for each."""
    rng = np.random.default_rng(5)

    def drawn(correlation: float) -> np.ndarray:
        common, own = rng.normal(size=20_000), rng.normal(size=(2, 20_000))
        return correlation**0.5 * common + (1 - correlation) ** 0.5 * own

    found = difference(LEFT_BREAST, RIGHT_BREAST, "sides")
    truth = np.array([[400.0], [300.0]])
    wall, boundary = np.array([[144.0], [108.0]]), np.array([[20.0], [15.0]])
    errors = wall * drawn(WALL_CORRELATION) + boundary * drawn(BOUNDARY_CORRELATION) + 0.01 * truth * drawn(1.0)
    measured = truth + errors / 1.96
    low, high = found.difference_interval_cc  # type: ignore[misc]
    gap = measured[0] - measured[1]
    assert np.mean((gap > low) & (gap < high)) == pytest.approx(0.95, abs=0.01)


@pytest.mark.requirement("R-VOL-11")
def test_errors_of_opposite_sign_add_up() -> None:
    """A turn of the body between exposures lifts one breast and lowers the other."""
    left = replace(LEFT_BREAST, interval_terms_cc={"movement": 13.0}, common_cc={"movement": (5.0, 12.0)})
    right = replace(RIGHT_BREAST, interval_terms_cc={"movement": 13.0}, common_cc={"movement": (5.0, -12.0)})
    assert difference(left, right, "sides").terms_cc["movement"] == pytest.approx(24.0)
    assert difference(left, right, "same pose").terms_cc["movement"] == pytest.approx(13.0 * 2**0.5)


def test_curves_that_persons_drew_share_nothing() -> None:
    drawn = replace(LEFT_BREAST, common_cc={})
    found = difference(drawn, RIGHT_BREAST, "sides")
    assert found.terms_cc["boundary"] == pytest.approx(25.0)


@pytest.mark.parametrize(("pairing", "u95_mm"), [("same pose", 1.2), ("across poses", 2.5)])
def test_one_breast_twice_shares_more_of_its_wall(pairing: str, u95_mm: float) -> None:
    found = difference(LEFT_BREAST, LEFT_BREAST, pairing, names=("after", "before"))  # type: ignore[arg-type]
    assert (found.first, found.second) == ("after", "before")
    assert found.terms_cc["chest wall"] == pytest.approx(u95_mm * 160.0 / 10)
    assert found.terms_cc["scale"] == 0.0
    assert found.difference_cc == 0.0
    assert found.beyond_error is False


def test_walls_of_two_kinds_share_nothing() -> None:
    other = replace(RIGHT_BREAST, wall_kind="plane")
    found = difference(LEFT_BREAST, other, "sides")
    assert found.terms_cc["chest wall"] == pytest.approx(np.hypot(144.0, 108.0))
    assert "(cylinder-membrane, plane)" in found.note


def test_no_interval_without_those_of_the_volumes() -> None:
    found = difference(LEFT_BREAST, replace(RIGHT_BREAST, interval_cc=None), "sides")
    assert found.difference_interval_cc is None
    assert found.ratio_interval is None
    assert found.beyond_error is None
    assert found.ratio == pytest.approx(4 / 3)


def test_swapping_turns_the_sign_alone() -> None:
    one, other = (difference(*pair, "sides") for pair in ((LEFT_BREAST, RIGHT_BREAST), (RIGHT_BREAST, LEFT_BREAST)))
    assert other.difference_cc == -one.difference_cc
    assert other.difference_interval_cc == pytest.approx(tuple(-end for end in reversed(one.difference_interval_cc)))  # type: ignore[arg-type]
    assert other.ratio_interval == pytest.approx(tuple(1 / end for end in reversed(one.ratio_interval)))  # type: ignore[arg-type]
