"""Skin that no pair measured is told from measured skin, in pictures and in the 3D view."""

import numpy as np
import pytest
import synthetic

from mammometry.geometry.mesh import TriangleMesh
from mammometry.report.figures.shading import front_frame
from mammometry.report.models import viewer_scene
from mammometry.report.words.describe import surface_report
from mammometry.surface.texture.texture_atlas import Atlas
from mammometry.surface.texture.unmeasured import GREY, faded, faded_atlas, shown_colours

SKIN = np.array([205, 160, 140], dtype=np.uint8)


@pytest.mark.requirement("R-VOL-5")
def test_skin_that_is_not_claimed_is_greyed_and_no_other() -> None:
    ball = synthetic.ball(3)
    repaired, colours = synthetic.repaired(ball), synthetic.textured(ball).colours
    shown = shown_colours(colours, repaired).astype(int)
    claimed = repaired.claimed
    assert (shown[claimed] == SKIN).all()
    towards_grey = np.abs(shown[~claimed] - GREY).max(axis=0) / np.abs(SKIN.astype(int) - GREY)
    assert (towards_grey < 0.5).all()
    whole = viewer_scene(front_frame(synthetic.rig()), repaired, synthetic.textured(ball)).models[0]
    assert whole.colours is not None
    np.testing.assert_array_equal(whole.colours, shown)


def test_the_photographs_are_faded_under_unmeasured_faces_alone() -> None:
    ball = synthetic.ball(0)
    repaired = synthetic.repaired(ball)
    behind, ahead = (
        np.argmax(ball.vertices[ball.faces].mean(axis=1)[:, 2]),
        np.argmin(ball.vertices[ball.faces].mean(axis=1)[:, 2]),
    )
    two = TriangleMesh(vertices=ball.vertices, faces=ball.faces[[behind, ahead]])
    places = np.array([[[0, 0], [9, 0], [0, 9]], [[20, 0], [29, 0], [20, 9]]], dtype=np.float32)
    picture = np.broadcast_to(SKIN, (12, 32, 3)).copy()
    atlas = Atlas(mesh=two, uv_px=places, picture=picture, view=np.array([0, 0]), names=("one",))
    shown = faded_atlas(atlas, repaired).picture
    row, column = np.indices((12, 32))
    under = row + column <= 9  # the first triangle, its edges included
    assert (shown[under] == faded(SKIN)).all()
    assert (shown[~under] == SKIN).all()
    unseen = Atlas(mesh=two, uv_px=places, picture=picture, view=np.array([-1, 0]), names=("one",))
    assert (faded_atlas(unseen, repaired).picture == SKIN).all()


def test_the_area_that_is_closed_and_what_of_it_is_bridged_are_said() -> None:
    ball = synthetic.ball(4)
    said = surface_report((), synthetic.repaired(ball))
    (fact,) = [each.value for each in said.facts if each.label == "Closed without measurement"]
    # By Archimedes, a sphere's zone has 2πRh: half of it is behind; a quarter of that is repaired, a quarter bridged.
    half_cm2 = 2 * np.pi * synthetic.RADIUS_MM**2 / 100
    closed, bridged = (float(word) for word in fact.split() if word.isdigit())
    assert abs(closed - 0.75 * half_cm2) < 0.03 * half_cm2  # a row of triangles of 5 mm
    assert abs(bridged - 0.25 * half_cm2) < 0.05 * half_cm2
