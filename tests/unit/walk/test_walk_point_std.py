"""Uncertainty of a walk's points where photographs do not show the body."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from tests.unit.walk.test_pairs import MIDDLE, looking

from mammometry.base.errors import CalibrationError
from mammometry.calibration.adjust.calibrated import ParameterCovariance
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA
from mammometry.geometry import Rig
from mammometry.walk.region import Region
from mammometry.walk.stations import Stations

REGION = Region(low_world=MIDDLE - 60.0, high_world=MIDDLE + 60.0)
CAMERAS = [looking(str(i), angle) for i, angle in enumerate((-12.0, 0.0, 12.0))]
AWAY = replace(CAMERAS[2], matrix=CAMERAS[2].matrix + np.array([[0.0, 0, 0], [0, 0, 5000.0], [0, 0, 0]]))


def point_std_mm(*cameras):
    pairs = {f"{a.name}-{b.name}": (a.name, b.name) for a, b in pairwise(cameras)}
    rig = Rig(name="telephone", cameras={camera.name: camera for camera in cameras}, pair_names=pairs)
    names = tuple(f"{camera}.{name}" for camera in rig.cameras for name in POSE_NAMES_CAMERA)
    matrix = np.diag(np.tile(np.repeat([1e-8, 1e-4], 3), len(rig.cameras)))
    covariance = ParameterCovariance(names=names, matrix=matrix, independent=matrix)
    stations = Stations(calibration=SimpleNamespace(), expanded=SimpleNamespace(rig=rig, covariance=covariance))
    return stations.point_std_mm(rig, REGION)


def test_a_pair_that_does_not_see_the_body_counts_for_nothing():
    assert point_std_mm(*CAMERAS[:2], AWAY) == pytest.approx(point_std_mm(*CAMERAS[:2]), rel=0.2)


def test_photographs_of_the_board_alone_are_refused():
    with pytest.raises(CalibrationError):
        point_std_mm(CAMERAS[1], AWAY)
