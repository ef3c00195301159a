"""A scanner's mesh whose boundaries are named the wrong way round stands on its head: the report says so."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import measurement

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.trunk.body import BodyDirections
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.warnings import mesh_warnings

BASE = np.array([[-50.0, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]])
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [0, 2, 1], [0, 3, 2]], dtype=np.int32)
UP = np.array([0.0, 1.0, 0.0])


def pyramid(name: str, tip_y_mm: float) -> VolumeMeasurement:
    """A breast whose tip lies below its base's middle."""
    closed = TriangleMesh(vertices=np.concatenate([BASE, [[0.0, tip_y_mm, 60.0]]]), faces=FACES)
    return replace(measurement(name), closed=closed, skin_faces=4, boundary_world=BASE)


def body(up: float) -> BodyDirections:
    frame = np.array([[up, 0, 0], [0, up, 0], [0, 0, 1.0]])
    return BodyDirections(frame=frame, point_world=np.zeros(3), plane_sigma_mm=None, scatter_mm=None)


def said(tip_y_mm: float, up: float, names: tuple[str, ...] = ("left", "right")) -> bool:
    found = mesh_warnings([pyramid(name, tip_y_mm) for name in names], body(up))
    return any(notice.code == "breasts-fuller-above" for notice in found)


def test_a_pyramids_mass_lies_a_quarter_of_the_way_to_its_tip() -> None:
    assert pyramid("left", -20.0).inferior_shift(UP) == pytest.approx(5 / 50)
    assert pyramid("left", -20.0).inferior_shift(-UP) == pytest.approx(-5 / 50)


@pytest.mark.requirement("R-SIDE-2")
def test_breasts_that_hang_upwards_are_told() -> None:
    assert said(-20.0, up=-1.0)
    assert not said(-20.0, up=1.0)


def test_mounds_and_single_breasts_say_nothing() -> None:
    assert not said(0.0, up=-1.0)
    assert not said(-20.0, up=-1.0, names=("left",))
