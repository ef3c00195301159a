"""Lengths, shape and symmetry in the report's words."""

import numpy as np

from mammometry.geometry.transform import Transform
from mammometry.hospital.exported import Quantity
from mammometry.measure.landmarks.landmarks import Landmark
from mammometry.measure.shape.anthropometry import BreastShape, Dimensions
from mammometry.measure.shape.lengths import LinearMeasure, Ptosis
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.report.words.anthropometry import dimension_tables, planning_lengths, quantities_of, symmetry_facts


def sizes_of_the_left() -> Dimensions:
    return Dimensions(
        frame=np.eye(3),
        shapes=(
            BreastShape(
                name="left", skin_cm2=250.0, base_width_mm=121.0, base_height_mm=133.0, base_sigma_mm=4.2,
                projection_mm=41.26, projection_sigma_mm=1.2, quadrants_cc={"upper lateral": 80.0},
                above_nipple_cc=150.4, below_nipple_cc=99.6, pole_sigma_cc=12.0,
            ),
        ),
        lengths=(
            LinearMeasure(
                name="N-midline left", title="left nipple to midline", straight_mm=88.25, straight_sigma_mm=2.04,
                geodesic_mm=None, geodesic_sigma_mm=None, ends_world=((88.25, 0.0, 0.0), (0.0, 0.0, 0.0)),
            ),
        ),
        ptosis=(
            Ptosis(
                name="left", grade="I", likely=("I", "II"), nipple_below_fold_mm=-4.5, sigma_mm=3.0,
                nipple_above_lowest_mm=20.0,
            ),
        ),
    )  # fmt: skip


def test_the_first_pages_lengths_are_the_exported_ones() -> None:
    sizes = sizes_of_the_left()
    exported = [Quantity(**row) for row in quantities_of(sizes)]
    assert [(each.name, each.title, each.value, each.unit, each.sigma, each.method) for each in exported] == [
        ("n_midline_straight_left", "nipple to midline, straight", 88.25, "mm", 2.04, "straight"),
        ("boundary_width_left", "Boundary width", 121.0, "mm", 4.2, "extent"),
        ("boundary_height_left", "Boundary height", 133.0, "mm", 4.2, "extent"),
        ("upper_pole_left", "Volume above the nipple's level", 150.4, "cm3", 12.0, "level-cut"),
        ("lower_pole_left", "Volume below the nipple's level", 99.6, "cm3", 12.0, "level-cut"),
        ("nipple_below_fold_left", "Nipple below the fold", -4.5, "mm", 3.0, "height"),
    ]
    table, note = planning_lengths(sizes)
    assert table is not None
    assert tuple(tuple(cell.replace("\u00a0", " ") for cell in row) for row in table.rows) == (
        ("Nipple to midline", "88.2 ± 4.0", "–", "–"),
        ("Boundary width", "121 ± 8", "–", "–"),
        ("Projection", "41.3 ± 2.4", "–", "–"),
        ("Nipple below the fold (ptosis)", "−4 ± 6", "–", "–"),
        ("Ptosis, grade after Regnault", "I or II", "–", ""),
    )
    assert note == (
        "Not measured, because a landmark is not marked: sternal notch to nipple; nipple to fold, along the skin; "
        "base width, straight."
    )
    assert planning_lengths(None) == (None, "")


def test_tables_say_values_with_their_uncertainty_and_leave_out_what_is_not_there() -> None:
    sizes = sizes_of_the_left()
    tables = {table.title: table for table in dimension_tables(sizes)}
    assert tables["Lengths, ± 95 %"].rows == (("left nipple to midline", "88.2 ± 4.0", "–"),)
    assert tables["Shape, ± 95 %"].rows[0][1:] == ("121 × 133", "41.3 ± 2.4", "150 ± 24", "100 ± 24")
    assert tables["Ptosis (Regnault)"].rows[0][1:] == ("I", "I, II", "−4 ± 6")
    assert "Landmarks" not in tables
    picked = Landmark(name="sternal_notch", points_world=np.zeros((1, 3)), method="picked", sigma_mm=2.0)
    assert dimension_tables(sizes, (picked,))[-1].rows == (("sternal notch", "Picked.", "2.0", "1.00"),)
    assert dimension_tables(None) == ()


def test_symmetry_in_words() -> None:
    found = Symmetry(
        plane_point_world=np.zeros(3), plane_normal_world=np.array([1.0, 0, 0]), plane_sigma_mm=0.4,
        trunk_scatter_mm=1.38, left_from_mirrored=Transform.identity(), shift_mm=np.array([6.5, -4.5, 0.0]),
        turn_deg=11.6, difference_cc=-8.6, difference_interval_cc=(-60.0, 43.0),
        ratio=0.97, rms_mirrored_mm=3.87, rms_mm=2.46,
        left_mm=np.zeros(1), right_mm=np.zeros(1),
    )  # fmt: skip
    said = " | ".join(fact.value for fact in symmetry_facts(found))
    assert "2.5 mm, with one breast aligned to the other" in said
    assert "+6.5 mm sideways, −4.5 mm up, 0.0 mm forwards, turned by 12°" in said
    assert symmetry_facts(None) == ()
