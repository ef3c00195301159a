"""Published calibrations, from their authors' own point lists."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mammometry.calibration.adjust.adjustment import Adjustment
from mammometry.calibration.adjust.bundle import all_views, network_of
from mammometry.calibration.adjust.initialise import initialise
from mammometry.calibration.adjust.least_squares import minimise
from mammometry.calibration.adjust.network import residuals, tie_of
from mammometry.calibration.adjust.projection import INTRINSIC_NAMES
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.settings import BundleSettings
from mammometry.calibration.targets.kinds.points import PointsTarget

ZHANG = "imagingbook-calibrate-lib/src/main/resources/imagingbook/calibration/zhang/data/TextDataResource-data"


@pytest.mark.data
def test_zhang_1998(shared_data: Path) -> None:
    """Zhang's five views: two focal lengths, skew, principal point, two radial terms; plain least squares.

    All digits of his table (MSR-TR-98-71; fx 832.5, skew 0.2045, fy 832.53, centre 303.959, 206.585, k −0.2286,
    0.1904, RMS 0.3364). The file beside his points has six digits: his descent ended 5e-6 px of skew before ours.
    """
    folder = shared_data / "zhang" / ZHANG
    plane = np.loadtxt(folder / "Model.txt").reshape(-1, 2)
    target = PointsTarget(points_mm=tuple((float(x), float(y), 0.0) for x, y in plane))
    count = len(plane)
    detections = tuple(
        Detection(
            camera="zhang",
            pose=str(view),
            ids=np.arange(count),
            uv=np.loadtxt(folder / f"data{view}.txt").reshape(-1, 2),
            covariance_px2=np.tile(np.eye(2), (count, 1, 1)),
        )
        for view in range(1, 6)
    )
    observations = Observations(target=target, sizes_wh={"zhang": (640, 480)}, detections=detections)
    initial = initialise(observations)
    views = all_views(observations, {}, initial)
    network, start = network_of(views, observations, {}, initial, {}, BundleSettings())
    names = ("fx_px", "skew_px", "fy_px", "cx_px", "cy_px", "k1", "k2")
    network = replace(network, tie=tie_of(names), intrinsic_names=names)
    held = np.zeros(network.pose_count, bool)
    held[network.columns_of_station(0)] = True
    problem = Adjustment(
        network=network, active=np.ones(5 * count, bool), held=held, group_sigma=np.ones(2), huber=np.inf
    )
    found = minimise(problem, start, max_iterations=50, tolerance=1e-7)
    assert found.converged
    value = dict(zip(INTRINSIC_NAMES, found.state.intrinsics[0].tolist(), strict=True))
    printed = {
        **{"fx_px": "832.5", "skew_px": "0.2045", "fy_px": "832.53", "cx_px": "303.959", "cy_px": "206.585"},
        **{"k1": "-0.2286", "k2": "0.1904"},
    }
    assert {name: f"{value[name]:.{len(digits.partition('.')[2])}f}" for name, digits in printed.items()} == printed
    lengths = np.linalg.norm(residuals(network, found.state)[0], axis=1)
    assert f"{np.sqrt(np.mean(lengths**2)):.4f}" == "0.3364"
