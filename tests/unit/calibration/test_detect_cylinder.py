"""The dotted cylinder: exact pictures of two cameras, and the real capture's."""

import cv2
import numpy as np
import pytest
from printed import camera, photograph_of_cylinder, read

from mammometry.base.errors import CalibrationError
from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.detection.detect import detect, detect_in
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.geometry.transform import Transform

pytestmark = pytest.mark.slow

CYLINDER = DottedCylinderTarget(dots=(8, 16), radius_mm=50.0, row_pitch_mm=12.0, column_pitch_mm=12.0, dot_mm=5.0)
LABELS = np.random.default_rng(5).random((16, 8, 8)) < 0.35


def view_from(azimuth_deg: float, name: str):
    """A camera that looks at the cylinder from that azimuth, a little from above, the labels up."""
    base = camera(size_wh=(420, 480), focal_px=1150.0)
    azimuth = np.radians(azimuth_deg)
    outward = np.array([np.cos(azimuth) * 0.97, np.sin(azimuth) * 0.97, 0.25])
    outward /= np.linalg.norm(outward)
    x = np.cross([0.0, 0.0, -1.0], -outward)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(-outward, x), -outward])
    centre = np.array([0.0, 0.0, 44.0]) + 420.0 * outward
    return type(base)(
        name=name,
        size_wh=base.size_wh,
        matrix=base.matrix,
        distortion=np.array([-0.1, 0.05, 0.0, 0.0, 0.0]),
        camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre),
    )


@pytest.fixture(scope="module")
def views():
    return {"left": view_from(75.0, "left"), "right": view_from(118.0, "right")}


@pytest.fixture(scope="module")
def photographs(views):
    return {("00", name): photograph_of_cylinder(view, CYLINDER, LABELS) for name, view in views.items()}


def test_both_cameras_agree_on_the_columns_and_centres_are_exact(views, photographs):
    observations = detect(photographs, CYLINDER)
    turn = None
    for detection in observations.detections:
        view = views[detection.camera]
        projected = view.project(CYLINDER.points_target)
        # The numbering starts anywhere: it is the same turn for both cameras.
        nearest = np.linalg.norm(projected[None] - detection.uv[:, None], axis=2).argmin(axis=1)
        assert np.array_equal(nearest // 16, detection.ids // 16)
        turns = np.unique((nearest - detection.ids) % 16)
        assert len(turns) == 1
        assert turn is None or turn == turns[0]
        turn = turns[0]
        assert len(detection.ids) >= 8 * 6
        # Curvature alone moves the centroids by up to 0.15 px towards the middle.
        error = detection.uv - projected[nearest]
        assert np.abs(error.mean(axis=0)).max() < 0.01
        assert np.sqrt(np.square(error).mean()) < 0.03
    first, second = (set(detection.ids.tolist()) for detection in observations.detections)
    assert len(first & second) >= 8 * 3


@pytest.mark.slow
def test_labels_that_do_not_agree_are_said(views, photographs):
    other = np.random.default_rng(6).random((16, 8, 8)) < 0.35
    mixed = photographs | {("00", "right"): photograph_of_cylinder(views["right"], CYLINDER, other)}
    with pytest.raises(CalibrationError, match="00/right"):
        detect(mixed, CYLINDER)


def test_more_columns_than_the_target_has_are_said(photographs):
    few = DottedCylinderTarget(dots=(8, 9), radius_mm=50.0, row_pitch_mm=12.0, column_pitch_mm=12.0, dot_mm=5.0)
    with pytest.raises(CalibrationError, match=r"\b9\b"):
        detect(photographs, few)


def test_a_cylinder_of_other_rows_or_none_is_not_found(photographs):
    other = DottedCylinderTarget(dots=(9, 16), radius_mm=50.0, row_pitch_mm=12.0, column_pitch_mm=12.0)
    assert detect_in(photographs["00", "left"], other, camera="left", pose="00") is None
    blank = Photograph(name="blank", pixels=np.full((300, 200), 90, np.uint8))
    assert detect_in(blank, CYLINDER, camera="left", pose="00") is None


def test_the_dots_size_need_not_be_known(views, photographs):
    unknown = DottedCylinderTarget(dots=(8, 16), radius_mm=50.0, row_pitch_mm=12.0, column_pitch_mm=12.0)
    known = detect_in(photographs["00", "left"], CYLINDER, camera="left", pose="00")
    found = detect_in(photographs["00", "left"], unknown, camera="left", pose="00")
    assert np.array_equal(known.ids, found.ids)
    assert np.abs(known.uv - found.uv).max() < 0.05


@pytest.mark.data
@pytest.mark.slow
def test_the_real_cylinder_is_resected_and_reconstructed(shared_data):
    """MultiDIC's cylinder: 0.44–0.55 px and 0.0555 mm with its authors' points and cameras (data/README.md)."""
    folder = shared_data / "multidic" / "sample_data"
    target = DottedCylinderTarget(dots=(20, 14), radius_mm=57.0, row_pitch_mm=12.0, column_pitch_mm=12.0)
    board = ChessboardTarget(squares=(15, 20), square_mm=10.0)
    names = ("201", "202")
    pictures = {("00", name): read(folder / "calibrationObjectImages" / f"{name}.jpg") for name in names}
    observations = detect(pictures, target)
    own = {
        name: detect(
            {(path.stem, name): read(path) for path in sorted((folder / "BAcheckerboardImages" / name).glob("*.jpg"))},
            board,
        )
        for name in names
    }
    assert [len(of_camera.detections) for of_camera in own.values()] == [25, 25]
    calibration = calibrate(observations, {"pair": names}, "multidic", intrinsics_observations=own)
    for residuals in calibration.residuals_px:
        used = np.isfinite(residuals).all(axis=1)
        assert used.mean() > 0.95
        assert np.sqrt(np.square(residuals[used]).sum(axis=1).mean()) < 0.55
    left, right = (calibration.rig.cameras[name] for name in names)
    assert np.linalg.norm(left.centre_world - right.centre_world) == pytest.approx(180.1, abs=1.0)
    first, second = observations.detections
    common, i, j = np.intersect1d(first.ids, second.ids, return_indices=True)
    assert len(common) >= 100
    projections = [
        np.column_stack([view.camera_from_world.rotation, view.camera_from_world.translation_mm])
        for view in (left, right)
    ]
    sides = [left.normalised_from_pixels(first.uv[i]).T, right.normalised_from_pixels(second.uv[j]).T]
    homogeneous = cv2.triangulatePoints(*projections, *sides)
    error_mm = (homogeneous[:3] / homogeneous[3]).T - target.points_target[common]
    assert np.sqrt(np.square(error_mm).sum(axis=1).mean()) < 0.07
