"""The data of the paper's Fig. 5, and its picture."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from spheres import camera_towards, ellipsoid_range, range_image

from mammometry.base.errors import SurfaceError
from mammometry.report.figures.paper import draw_dent_grid
from mammometry.surface.ranges.dents import decompose, dent_grid, remove_dents
from mammometry.surface.ranges.visibility import Label
from mammometry.surface.settings import DecomposeSettings, DentSettings


def views(shift=0.0):
    """Three views of a sphere; the second has its surface nearer by `shift` mm."""
    images = []
    for name, direction in (("a", (0, 0, 1)), ("b", (0.5, 0, 1)), ("c", (2.0, 0, 1))):
        camera = camera_towards(name, direction)
        images.append(range_image(camera, ellipsoid_range(camera, (30.0,) * 3) - (shift if name == "b" else 0.0)))
    return images


def test_each_cell_is_the_papers_rule_at_that_angle_and_tolerance():
    images = views()[:2]
    grid = dent_grid(images, angles_deg=(40, 70), epsilons_mm=(0.1, 1.5))
    assert (grid.name, grid.against) == ("a", "b")
    assert grid.kept.shape == (2, 2, 120, 120)
    for row, angle in enumerate((40, 70)):
        for column, epsilon in enumerate((0.1, 1.5)):
            patches = decompose(images, DecomposeSettings(epsilon_mm=epsilon))
            settings = DentSettings(rule="patch", angle_deg=angle, neighbourhood_mm=5.0)
            expected = remove_dents(images, patches, settings).range_images[0].valid
            np.testing.assert_array_equal(grid.kept[row, column], expected)
            np.testing.assert_array_equal(grid.labels[column], patches.labels["a", "b"])
    assert (grid.kept[0] <= grid.kept[1]).all()  # a larger angle removes no more


def test_rows_and_columns_are_the_papers_unless_said_otherwise():
    """Fig. 5 is printed with thresholds of 40 to 70 degrees and tolerances of 0.0, 0.1, 1.0 and 1.5 mm."""
    grid = dent_grid(views()[:2])
    assert grid.angles_deg == (40.0, 50.0, 60.0, 70.0)
    assert grid.epsilons_mm == (0.0, 0.1, 1.0, 1.5)


def test_the_tolerance_decides_what_overlaps():
    grid = dent_grid(views(shift=1.0)[:2], name="a", epsilons_mm=(0.5, 1.5))
    overlapping = (grid.labels == Label.OVERLAPPING).sum(axis=(1, 2))
    assert overlapping[0] < 0.2 * overlapping[1]
    assert overlapping[1] > 1000


def test_the_view_with_most_in_common_is_chosen():
    assert dent_grid(views(), epsilons_mm=(0.5,)).against == "b"
    assert dent_grid(views(), name="c", against="a", epsilons_mm=(0.5,)).against == "a"


@pytest.mark.parametrize(("count", "name", "against"), [(1, None, None), (3, "x", None), (3, "a", "a")])
def test_two_different_views_are_needed(count, name, against):
    with pytest.raises(SurfaceError, match="pairs"):
        dent_grid(views()[:count], name=name, against=against)


def test_the_picture_shows_what_is_removed_in_black():
    grid = dent_grid(views(), angles_deg=(40, 89), epsilons_mm=(0.5,))
    half_kept = grid.valid & (np.arange(grid.valid.shape[0]) < 60)[:, None]
    grid = replace(grid, kept=np.array([[half_kept], [grid.valid]]))
    picture = np.asarray(Image.open(io.BytesIO(draw_dent_grid(grid).printed("png"))).convert("L"))
    half = picture.shape[0] // 2
    # both panels have the same frame and text; a panel is 630 pixels wide at 300 dpi, the data about 60 elements
    dark = [int((part < 20).sum()) for part in (picture[:half], picture[half:])]
    share = (grid.valid & ~half_kept).sum() / np.prod([np.ptp(axis) + 1 for axis in np.nonzero(grid.valid)])
    assert dark[0] - dark[1] == pytest.approx(share * 630 * 630, rel=0.1)
