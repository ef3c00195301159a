"""Resample a converging pair so that corresponding points are on one row."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from scipy import ndimage
from scipy.interpolate import BSpline, make_interp_spline

from mammometry.base.errors import ImageError, MatchingError
from mammometry.base.photograph import LUMA, Photograph
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float32, Float64, StereoPair, Transform
from mammometry.geometry.lens import fold_radius
from mammometry.matching.correlation_kernels import sample_spline, spline_along_rows, weighted_channels
from mammometry.matching.filters import blur, rim
from mammometry.matching.foreground.foreground import Foreground

MARGIN_PX = 16
"""Pixels kept around the subject's silhouette in both rectified images, for windows and filters."""
_LEAST_AXES_COSINE = 0.17  # least cosine between the optical axes, 80°: at larger angles they hardly see the same skin
_ROUND_TRIP_PX = 0.1  # largest error through the lens model and back; more means that the model folds back there
_LEAST_COSINE = 0.2  # cosine between a ray and the common axis: nothing can be resampled beyond 78°
_LEAST_SQUARE_SHARE = 0.5  # least share of the mean axis across the baseline: else one camera sees the other
_WIDEST_TANGENT = 2.0  # widest field of view, 127°: wider lenses are fisheyes, which this lens model does not describe
_LARGEST_GROWTH = 4.0  # largest area of a rectified image, in photographs: a larger one means a useless geometry
_SMALLEST_SIDE_PX = 8  # smallest side of the common region without margins: one window
_SPLINE_REACH_PX = 10  # the influence of farther pixels on a cubic spline coefficient is below 2e-6
_BAND_ROWS = 256  # rows resampled at a time, to limit memory
_BLOWN, _BLOWN_RIM_PX = 0.985, 2  # share of full luma that is saturated, and width of its blurred border
_SPLINE_POLE = np.sqrt(3) - 2
# Cubic B-spline coefficients of samples: Σ_k √3 pole^|k| f(i + k) (Unser 1999), cut off where the pole's power is 2e-6.
SPLINE_TAPS = (np.sqrt(3) * _SPLINE_POLE ** np.abs(np.arange(-_SPLINE_REACH_PX, _SPLINE_REACH_PX + 1))).astype(
    np.float32
)
_SAFE_SHARE = 0.99  # share of the lens's field that is used; the radius grows by less than the rest between grid points
_MAP_STEP_PX = 8  # the resampling map is smooth: exact on this grid, cubic in between


@value(eq=False)
class RectifiedPair:
    """Two images of one size with corresponding rows, from ideal cameras at the original centres."""

    name: str
    left: Camera
    """Ideal (no distortion). `right` has the same orientation, focal length and principal row; only its principal
    column differs."""
    right: Camera
    left_image: Float32[Array, "h w"]
    """Luma, 0…1, by cubic B-spline resampling at the photographs' resolution. 0 far from the subject."""
    right_image: Float32[Array, "h w"]
    left_mask: Bool[Array, "h w"]
    """Pixels that show the subject, are inside the photograph and are not saturated."""
    right_mask: Bool[Array, "h w"]


def rectify(
    pair: StereoPair,
    left: Photograph,
    right: Photograph,
    left_foreground: Foreground,
    right_foreground: Foreground,
    *,
    middle_world: Float64[Array, "3"] | None = None,
) -> RectifiedPair:
    """Make both cameras parallel and resample the subject's region.

    Each camera is rotated about its own centre. The new x axis is the baseline. The new z axis is the mean of the two
    optical axes made perpendicular to it. The focal length is the photographs' mean, so that their resolution is kept
    at the subject's centre. Principal columns are chosen for each image so that the subject fills it: its disparity is
    then small for any convergence. If no silhouette is known, they are chosen so that `middle_world`, mm, has no
    disparity.

    Raises:
        ImageError: a photograph or foreground does not have its camera's size.
        MatchingError: the cameras are at one position, look away from each other, or see no common row of the subject.
    """
    sides = ((left, left_foreground, pair.left), (right, right_foreground, pair.right))
    for photograph, foreground, camera in sides:
        if photograph.size_wh != camera.size_wh or foreground.coverage.shape != camera.shape_hw:
            raise ImageError(
                photograph.name,
                found=f"{photograph.size_wh[0]} × {photograph.size_wh[1]} pixels, "
                f"foreground {foreground.coverage.shape[1]} × {foreground.coverage.shape[0]}",
                expected=f"{camera.size_wh[0]} × {camera.size_wh[1]} as in the calibration of {camera.name}",
                remedy="Use the original photographs of the camera, not cropped or scaled",
            )
    rotation = _common_rotation(pair)
    focal = float(np.mean([camera.matrix[axis, axis] for camera in (pair.left, pair.right) for axis in (0, 1)]))
    with ThreadPoolExecutor(len(sides)) as pool:
        outlines = list(pool.map(lambda side: _outline(side[2], side[1], rotation, focal), sides))
    shift = None
    if middle_world is not None and (left_foreground.everything or right_foreground.everything):
        shift = _parallax(pair, rotation, focal, middle_world)
    cameras = _ideal_cameras(pair, rotation, focal, outlines, shift)
    with ThreadPoolExecutor(len(sides)) as pool:
        (left_image, left_mask), (right_image, right_mask) = pool.map(_resample, sides, cameras)
    return RectifiedPair(
        name=pair.name,
        left=cameras[0],
        right=cameras[1],
        left_image=left_image,
        right_image=right_image,
        left_mask=left_mask,
        right_mask=right_mask,
    )


def _common_rotation(pair: StereoPair) -> Float64[Array, "3 3"]:
    """Rotation from the world's axes to those of both rectified cameras."""
    baseline = pair.right.centre_world - pair.left.centre_world
    length = float(np.linalg.norm(baseline))
    axis = pair.left.axis_world + pair.right.axis_world
    if length < 1e-6 or float(pair.left.axis_world @ pair.right.axis_world) < _LEAST_AXES_COSINE:
        raise MatchingError(
            f"pair {pair.name}",
            found=f"cameras {length:.3g} mm apart with an angle between their axes of "
            f"{np.degrees(np.arccos(np.clip(pair.left.axis_world @ pair.right.axis_world, -1, 1))):.0f}°",
            expected="two different positions with an angle of less than 80° between the axes",
            remedy="Check which cameras form the pair, and their calibration",
        )
    x = baseline / length
    z = axis - (axis @ x) * x
    if np.linalg.norm(z) < _LEAST_SQUARE_SHARE:
        raise MatchingError(
            f"pair {pair.name}",
            found="one camera in the other's line of sight",
            expected="cameras side by side",
            remedy="Check which cameras form the pair, and their calibration",
        )
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z])


def _outline(
    camera: Camera, foreground: Foreground, rotation: Float64[Array, "3 3"], focal: float
) -> Float64[Array, "n 2"]:
    """Rectified positions, relative to the principal point, of the subject's outermost pixels."""
    pixels = rim(foreground.coverage, foreground.contour_level).astype(np.float64)
    if len(pixels) == 0:
        raise MatchingError(
            f"camera {camera.name}",
            found="a foreground without pixels",
            expected="the subject in the image",
            remedy="Check the mask, or set matching.foreground.mode to all",
        )
    ideal = camera.normalised_from_pixels(pixels)
    # Where the lens model folds back (corners far outside the calibrated field) a pixel has no direction.
    known = np.hypot(*ideal.T) < _field_radius(camera)
    known &= np.abs(camera.pixels_from_normalised(ideal) - pixels).max(axis=1) < _ROUND_TRIP_PX
    rays = camera.rays_world(pixels[known]) @ rotation.T
    rays = rays[rays[:, 2] > _LEAST_COSINE]
    if len(rays) == 0:
        raise MatchingError(
            f"camera {camera.name}",
            found="a lens model that folds back in the whole area of the subject",
            expected="distortion coefficients that are valid over the whole image",
            remedy="Check the calibration of this camera",
        )
    return focal * rays[:, :2] / rays[:, 2:]


def _field_radius(camera: Camera) -> float:
    """Ideal radius up to which the lens does not fold back, as the tangent of the angle to the axis."""
    return min(fold_radius(camera.distortion), _WIDEST_TANGENT)


def _parallax(
    pair: StereoPair, rotation: Float64[Array, "3 3"], focal: float, point_world: Float64[Array, "3"]
) -> float:
    """Disparity of a point, px, with equal principal columns."""
    length = float(np.linalg.norm(pair.right.centre_world - pair.left.centre_world))
    return focal * length / float(rotation[2] @ (point_world - pair.left.centre_world))


def _ideal_cameras(
    pair: StereoPair,
    rotation: Float64[Array, "3 3"],
    focal: float,
    outlines: list[Float64[Array, "_ 2"]],
    shift_px: float | None,
) -> tuple[Camera, Camera]:
    """Both rectified cameras, cropped to the subject, with common rows and separate column ranges."""
    low = np.array([outline.min(axis=0) for outline in outlines])
    high = np.array([outline.max(axis=0) for outline in outlines])
    top, bottom = low[:, 1].max(), high[:, 1].min()
    if shift_px is not None:  # without an outline, align the subject's centre
        left, right = low[:, 0].copy(), high[:, 0].copy()
        left[:] = max(left[0], left[1] + shift_px) - np.array([0, shift_px])
        right[:] = min(right[0], right[1] + shift_px) - np.array([0, shift_px])
        reach = 0.25 * (right - left)
        left, right = np.maximum(left - reach, low[:, 0]), np.minimum(right + reach, high[:, 0])
        left[:] = min(left[0], left[1] + shift_px) - np.array([0, shift_px])
    else:
        left, right = low[:, 0], high[:, 0]
    left, right = left - MARGIN_PX, right + MARGIN_PX
    top, bottom = top - MARGIN_PX, bottom + MARGIN_PX
    width = int(np.ceil((right - left).max())) + 1
    height = int(np.ceil(bottom - top)) + 1
    pixels = pair.left.size_wh[0] * pair.left.size_wh[1]
    if min(height, width) <= 2 * MARGIN_PX + _SMALLEST_SIDE_PX:
        raise MatchingError(
            f"pair {pair.name}",
            found="no common rows of the subject in the two rectified images",
            expected="both cameras to see the same part of it",
            remedy="Check the pair's cameras, their calibration and the foreground",
        )
    if width * height > _LARGEST_GROWTH * pixels:
        raise MatchingError(
            f"pair {pair.name}",
            found=f"a rectified image of {width} × {height} pixels",
            expected=f"at most {_LARGEST_GROWTH:.0f} times the photograph's {pixels}",
            remedy="Check the calibration: the cameras seem to point in very different directions",
        )
    made = []
    for camera, column in ((pair.left, left[0]), (pair.right, left[1])):
        made.append(
            Camera(
                name=camera.name,
                size_wh=(width, height),
                matrix=np.array([[focal, 0.0, -column], [0.0, focal, -top], [0.0, 0.0, 1.0]]),
                distortion=np.zeros(5),
                camera_from_world=Transform(rotation=rotation.copy(), translation_mm=-rotation @ camera.centre_world),
            )
        )
    return made[0], made[1]


def _resample(
    side: tuple[Photograph, Foreground, Camera], ideal: Camera
) -> tuple[Float32[Array, "h w"], Bool[Array, "h w"]]:
    """Luma and mask of the rectified image by cubic B-splines. The mask is derived from the coverage."""
    photograph, foreground, camera = side
    height, width = ideal.shape_hw
    image = np.empty((height, width), dtype=np.float32)
    mask = np.empty((height, width), dtype=bool)
    source = _SourceMap(camera, ideal)
    reach = np.array([source.at(slice(0, height, _MAP_STEP_PX))[axis] for axis in (0, 1)])
    rows, columns = _read_part(reach[1], camera.size_wh[1]), _read_part(reach[0], camera.size_wh[0])
    pixels = np.atleast_3d(photograph.pixels)[rows, columns]
    luma = weighted_channels(
        pixels, LUMA[: pixels.shape[2]] / LUMA[: pixels.shape[2]].sum() / np.iinfo(pixels.dtype).max
    )
    # A saturated highlight moves with the viewer, and so does its border: it is not a feature of the skin.
    blown = luma >= _BLOWN
    usable = (~ndimage.binary_dilation(blown, iterations=_BLOWN_RIM_PX)).astype(np.float32) if blown.any() else None
    coefficients = blur(luma, SPLINE_TAPS)
    del luma, blown
    corner = np.array([columns.start, rows.start], dtype=np.float32)
    for top in range(0, height, _BAND_ROWS):
        band = slice(top, min(top + _BAND_ROWS, height))
        u, v, known = source.at(band)
        # OpenCV's steps of 1/32 px are enough for the mask; the luma, which is matched to hundredths, needs more.
        coverage = cv2.remap(
            foreground.coverage, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(0.0,)
        )
        inside = known & (u >= 0) & (u <= camera.size_wh[0] - 1) & (v >= 0) & (v <= camera.size_wh[1] - 1)
        mask[band] = inside & (coverage >= foreground.contour_level)
        u -= corner[0]
        v -= corner[1]
        image[band] = sample_spline(coefficients, u, v, coverage > 0)
        if usable is not None:
            mask[band] &= cv2.remap(usable, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) > 0.5
    return image, mask


def _read_part(positions: Float32[Array, "h w"], size: int) -> slice:
    """Rows or columns of the photograph needed for the positions, including the spline's support."""
    start = int(np.clip(positions.min() - _SPLINE_REACH_PX, 0, size - 2 * _SPLINE_REACH_PX))
    stop = int(np.clip(positions.max() + _SPLINE_REACH_PX, start + 2 * _SPLINE_REACH_PX, size))
    return slice(start, stop)


class _SourceMap:
    """Position in the photograph of each rectified pixel: exact on a coarse grid, cubic in between."""

    def __init__(self, camera: Camera, ideal: Camera) -> None:
        height, width = ideal.shape_hw
        knots_v = np.linspace(0, height - 1, max(height // _MAP_STEP_PX, 4) + 1)
        knots_u = np.linspace(0, width - 1, max(width // _MAP_STEP_PX, 4) + 1)
        rays = ideal.rays_world(np.stack(np.meshgrid(knots_u, knots_v), axis=-1)) @ camera.camera_from_world.rotation.T
        normalised = rays[..., :2] / np.maximum(rays[..., 2:], 1e-3)
        source = camera.pixels_from_normalised(normalised)
        radius = np.hypot(normalised[..., 0], normalised[..., 1])
        self._field_radius = _field_radius(camera)
        self._known_everywhere = bool(radius.max() < _SAFE_SHARE * self._field_radius)
        if not self._known_everywhere:
            source = np.concatenate([source, radius[..., None]], axis=-1)
        along_v = make_interp_spline(knots_v, source, k=3, axis=0)
        along_u = make_interp_spline(knots_u, along_v.c, k=3, axis=1)
        self._coefficients = np.moveaxis(along_u.c, 0, 1)  # the interpolated axis comes first
        self._weights_v = BSpline.design_matrix(np.arange(height, dtype=np.float64), along_v.t, 3)
        weights_u = BSpline.design_matrix(np.arange(width, dtype=np.float64), along_u.t, 3)
        self._first_u = weights_u.indices.reshape(width, 4)[:, 0].astype(np.int64)
        self._weights_u = weights_u.data.reshape(width, 4)

    def at(self, rows: slice) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"], Bool[Array, "h w"]]:
        """Columns and rows in the photograph, and where the lens model is valid."""
        weights = self._weights_v[rows]
        u, v, *radius = (
            spline_along_rows(weights @ self._coefficients[..., axis], self._first_u, self._weights_u)
            for axis in range(self._coefficients.shape[2])
        )
        return u, v, radius[0] < self._field_radius if radius else np.ones(u.shape, dtype=bool)
