"""What a report says of who drew a boundary and who confirmed it: to oneself with names, to others without."""

from dataclasses import replace

import synthetic

from mammometry.measure.volume.attribution import Attribution, CurveConfirmation, attributed, curve_digest

LEFT = replace(
    synthetic.measurement("left"), boundary_method="given: 9 points, edited by hand", boundary_remarks=("given",)
)
SEEN = CurveConfirmation(by="C. Eye", at="2026-11-22T10:00:00Z", curve=curve_digest(LEFT.boundary_world))
DRAWN = Attribution(
    method="edited by hand", origin="edited by hand by Dr. B on 2026-11-20, from Dr. D's CT", confirmation=SEEN
)


def words(attributions: dict[str, Attribution], *, named: bool = True) -> str:
    return attributed(LEFT, attributions, named=named).boundary_method


def test_a_given_boundary_names_its_people() -> None:
    assert words({}) == LEFT.boundary_method
    assert words({"right": DRAWN}) == LEFT.boundary_method
    assert words({"left": DRAWN}) == (
        "given: 9 points, edited by hand by Dr. B on 2026-11-20, from Dr. D's CT; "
        "confirmed by eye by C. Eye on 2026-11-22"
    )


def test_a_report_for_others_names_nobody_and_no_date() -> None:
    assert words({"left": DRAWN}, named=False) == "given: 9 points; confirmed by eye"
    other = replace(DRAWN, confirmation=replace(SEEN, curve="another"))
    assert words({"left": other}, named=False) == (
        "given: 9 points; an earlier curve was confirmed by eye, but not this one"
    )
