"""How long the adjustment takes: generated observations, counted in seconds of one processor.

    python -m benchmarks.speed.bundle 32000 500000

Eight cameras on a ring see a board of 25 × 25 corners, which is adjusted too, in as many poses as that takes; every
point with 0.05 px of noise. The whole calibration is timed, from detections to cameras with their covariance, and apart
from it one adjustment alone, from the first values to the minimum.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from mammometry.calibration.adjust.assemble import all_views, held_at_first, network_of
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.adjust.initialise import initialise
from mammometry.calibration.adjust.robust import adjusted
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.settings import BundleSettings
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

BOARD = ChessboardTarget(squares=(26, 26), square_mm=10.0)
SIZE_WH = (4504, 3000)
NOISE_PX = 0.05


def cameras() -> dict[str, Camera]:
    """Eight cameras, 0.8 m from the origin, all looking at it."""
    found = {}
    for i, angle in enumerate(np.linspace(-0.6, 0.6, 8)):
        turn = Rotation.from_euler("yx", [angle, 0.15 * (-1) ** i]).as_matrix()
        found[f"camera_{i}"] = Camera(
            name=f"camera_{i}",
            size_wh=SIZE_WH,
            matrix=np.array([[8000.0, 0, 2250 + i], [0, 8001.0, 1500 - i], [0, 0, 1]]),
            distortion=np.array([-0.06, 0.1, 2e-4, -1e-4, 0.0]),
            camera_from_world=Transform(rotation=turn, translation_mm=np.array([0.0, 0.0, 800.0])),
        )
    return found


def observe(count: int) -> Observations:
    """At least `count` points, in whole poses."""
    rng, rig, points = np.random.default_rng(0), cameras(), BOARD.points_target
    middle = points.mean(axis=0)
    detections: list[Detection] = []
    seen, pose = 0, 0
    while seen < count:
        tilt = Rotation.from_rotvec(rng.uniform(-0.4, 0.4, size=3))
        placed = tilt.apply(points - middle) + rng.uniform(-30, 30, size=3)
        for name, camera in rig.items():
            uv = camera.project(placed)
            ids = np.flatnonzero(((uv > 0) & (uv < np.array(SIZE_WH) - 1)).all(axis=1))
            noise = NOISE_PX * rng.normal(size=(len(ids), 2))
            covariance = np.tile(NOISE_PX**2 * np.eye(2), (len(ids), 1, 1))
            detections.append(
                Detection(camera=name, pose=f"{pose:04d}", ids=ids, uv=uv[ids] + noise, covariance_px2=covariance)
            )
            seen += len(ids)
        pose += 1
    return Observations(target=BOARD, sizes_wh=dict.fromkeys(rig, SIZE_WH), detections=tuple(detections))


def main() -> None:
    """Print a table of times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("counts", type=int, nargs="*", default=[32_000, 500_000])
    print(
        "| points | poses | first values, s | one adjustment, s | whole calibration, s | RMS px |\n"
        + "| --- " * 6
        + "|"
    )
    for count in parser.parse_args().counts:
        observations = observe(count)
        points = sum(len(detection.ids) for detection in observations.detections)
        start = time.process_time()
        initial = initialise(observations)
        network, first = network_of(
            all_views(observations, {}, initial), observations, {}, initial, {}, BundleSettings()
        )
        begun = time.process_time()
        adjusted(network, held_at_first(network, {}), first, BundleSettings())
        ended = time.process_time()
        calibration = calibrate(observations, {"pair": ("camera_0", "camera_1")}, "generated")
        whole = time.process_time() - ended
        print(
            f"| {points} | {len(observations.poses)} | {begun - start:.1f} | {ended - begun:.1f} | {whole:.1f} | "
            f"{calibration.rms_px:.4f} |",
            flush=True,
        )


if __name__ == "__main__":
    with threadpool_limits(limits=1, user_api="blas"):  # as the job does: more are slower
        main()
