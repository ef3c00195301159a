"""Rectified geometry against the original cameras, and resampled values against an analytic picture."""

import numpy as np
import pytest
from tests.first_cases import first
from textured_pair import Texture

from mammometry.base.errors import ImageError, MatchingError
from mammometry.base.photograph import Photograph
from mammometry.geometry.camera import Camera, StereoPair
from mammometry.geometry.transform import Transform
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.rectify import RectifiedPair, rectify

SIZE_WH = (300, 220)


def converging(angle_deg: float = 30.0, *, distance_mm: float = 800.0) -> StereoPair:
    """Two distorted cameras that look at the origin from `angle_deg` apart, one a little rolled."""
    cameras = []
    for name, angle, roll in (("left", -angle_deg / 2, 0.02), ("right", angle_deg / 2, -0.03)):
        turn = Transform.from_rotation_vector(np.array([0.0, np.radians(angle), 0.0]), np.zeros(3))
        tilt = Transform.from_rotation_vector(np.array([0.0, 0.0, roll]), np.zeros(3))
        back = Transform(rotation=np.eye(3), translation_mm=np.array([0.0, 0.0, distance_mm]))
        cameras.append(
            Camera(
                name=name,
                size_wh=SIZE_WH,
                matrix=np.array([[600.0, 0, 152.0], [0, 604.0, 108.0], [0, 0, 1]]),
                distortion=np.array([-0.08, 0.05, 1e-3, -5e-4, 0.0]),
                camera_from_world=back @ tilt @ turn,
            )
        )
    return StereoPair(name="front", left=cameras[0], right=cameras[1])


def grey(texture: Texture) -> Photograph:
    v, u = np.mgrid[: SIZE_WH[1], : SIZE_WH[0]].astype(np.float64)
    pixels = np.rint(65535 * (0.5 + texture.at(u, v))).astype(np.uint16)
    return Photograph(name="capture/left.tif", pixels=pixels)


def foreground(mask: np.ndarray, *, everything: bool = False) -> Foreground:
    return Foreground(camera="c", coverage=mask.astype(np.float32), contour_level=0.5, everything=everything)


@pytest.fixture(scope="module")
def texture() -> Texture:
    return Texture.random(np.random.default_rng(0), shortest_px=6.0, longest_px=50.0, contrast=0.05)


@pytest.fixture(scope="module")
def disc() -> np.ndarray:
    v, u = np.mgrid[: SIZE_WH[1], : SIZE_WH[0]]
    return np.hypot(u - 150, v - 110) < 70


def rectified(pair: StereoPair, texture: Texture, mask: np.ndarray, *, everything: bool = False) -> RectifiedPair:
    photograph = grey(texture)
    subject = foreground(mask, everything=everything)
    return rectify(pair, photograph, photograph, subject, subject)


def test_rows_correspond_and_centres_stay(texture: Texture, disc: np.ndarray) -> None:
    pair = converging()
    result = rectified(pair, texture, disc)
    np.testing.assert_allclose(result.left.centre_world, pair.left.centre_world, atol=1e-9)
    np.testing.assert_allclose(result.right.centre_world, pair.right.centre_world, atol=1e-9)
    points = np.random.default_rng(1).uniform(-80, 80, (50, 3))
    left, right = result.left.project(points), result.right.project(points)
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    parallax = result.left.matrix[0, 2] - result.right.matrix[0, 2]
    depth = result.left.camera_from_world.apply(points)[:, 2]
    baseline = np.linalg.norm(pair.left.centre_world - pair.right.centre_world)
    assert result.left.matrix[0, 0] == result.right.matrix[1, 1] == pytest.approx(602)  # the mean of 600 and 604
    np.testing.assert_allclose(left[:, 0] - right[:, 0], parallax + 602 * baseline / depth, atol=1e-6)


def test_only_the_subject_is_kept_at_its_own_resolution(texture: Texture, disc: np.ndarray) -> None:
    result = rectified(converging(), texture, disc)
    width, height = result.left.size_wh
    assert 140 < width < 200  # 140 px of subject and 16 px of margin on either side, 7 % stretched by the obliquity
    assert 140 < height < 190
    # A plane seen 15° off the axis grows by 1/cos³.
    assert result.left_mask.sum() == pytest.approx(disc.sum() / np.cos(np.radians(15)) ** 3, rel=0.03)


def test_values_are_those_of_the_photograph_at_the_projected_position(texture: Texture, disc: np.ndarray) -> None:
    pair = converging()
    result = rectified(pair, texture, disc)
    for ideal, camera, image, mask in (
        (result.left, pair.left, result.left_image, result.left_mask),
        (result.right, pair.right, result.right_image, result.right_mask),
    ):
        rows, columns = np.nonzero(mask)
        rays = ideal.rays_world(np.stack([columns, rows], axis=1).astype(np.float64))
        uv = camera.project(ideal.centre_world + 800 * rays)
        # Cubic splines lose (2π/6)⁴/720 … of the shortest wave: under 1 % of the contrast of .05.
        np.testing.assert_allclose(image[mask], 0.5 + texture.at(uv[:, 0], uv[:, 1]), atol=2e-3)


@pytest.mark.parametrize("z_mm", first(1, [200.0, -150.0, 0.0]))
def test_a_whole_scene_is_aligned_where_the_subject_stands(z_mm: float, texture: Texture) -> None:
    pair, shot = converging(20.0), grey(texture)
    whole, middle = foreground(np.ones(SIZE_WH[::-1], dtype=bool), everything=True), np.array([5.0, -3.0, z_mm])
    result = rectify(pair, shot, shot, whole, whole, middle_world=middle)
    at = middle[None]
    assert abs(result.left.project(at)[0, 0] - result.right.project(at)[0, 0]) < 2
    assert result.left_mask.mean() > 0.6


def test_a_folded_lens_model_does_not_blow_the_picture_up(texture: Texture) -> None:
    pair = converging(20.0)
    folded = [
        Camera(
            name=camera.name,
            size_wh=camera.size_wh,
            matrix=camera.matrix,
            distortion=np.array([0.2, -0.1, 0.0, 0.0, -60.0]),  # grows, then turns back within the picture's corners
            camera_from_world=camera.camera_from_world,
        )
        for camera in (pair.left, pair.right)
    ]
    result = rectified(
        StereoPair(name="front", left=folded[0], right=folded[1]),
        texture,
        np.ones(SIZE_WH[::-1], dtype=bool),
        everything=True,
    )
    assert result.left.size_wh[0] < 2 * SIZE_WH[0]


@pytest.mark.parametrize("fault", ["size", "same place", "apart", "nothing"])
def test_what_cannot_be_rectified_is_refused_by_name(fault: str, texture: Texture, disc: np.ndarray) -> None:
    pair = converging()
    if fault == "size":
        small = foreground(disc[:-10])
        with pytest.raises(ImageError, match=r"capture/left\.tif.*left"):
            rectify(pair, grey(texture), grey(texture), small, small)
    elif fault == "same place":
        with pytest.raises(MatchingError, match=r"\bfront\b"):
            rectified(StereoPair(name="front", left=pair.left, right=pair.left), texture, disc)
    elif fault == "apart":
        with pytest.raises(MatchingError, match="100°"):
            rectified(converging(100.0), texture, disc)
    else:
        with pytest.raises(MatchingError, match=r"\bleft\b"):
            rectified(pair, texture, np.zeros_like(disc))


def test_a_saturated_highlight_is_no_skin(texture: Texture, disc: np.ndarray) -> None:
    plain = grey(texture)
    v, u = np.mgrid[: SIZE_WH[1], : SIZE_WH[0]]
    highlight = np.hypot(u - 150, v - 110) < 12
    bright = Photograph(name="bright", pixels=np.where(highlight, 65535, plain.pixels).astype(np.uint16))
    subject = foreground(disc)
    without = rectify(converging(), plain, plain, subject, subject)
    found = rectify(converging(), bright, plain, subject, subject)
    lost = without.left_mask & ~found.left_mask
    # The disc of radius 12 and a rim of 2 px (a cross grown twice), at about its own scale: 450 … 620 px.
    assert 450 < lost.sum() < 650
    np.testing.assert_array_equal(found.right_mask, without.right_mask)
