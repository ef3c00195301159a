"""Photographs of printed targets by an exact, independent renderer: every pixel the mean of many exact samples.

The pattern is known at every point; each pixel averages 4 × 4 rays, the picture is blurred by a Gaussian on the finer
raster, and written sRGB-encoded in 8 bit.
"""

from collections.abc import Callable

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from mammometry.base.photograph import Photograph
from mammometry.calibration.targets.kinds.charuco import CharucoTarget, charuco_board
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.circles import CirclesTarget
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

FINE = 4
DARK, BRIGHT, SURROUND = 0.05, 0.6, 0.1
MARKER_PX_PER_MM = 14.0


def camera(
    *,
    size_wh=(640, 480),
    focal_px=900.0,
    distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    turn_deg=(0.0, 0.0, 0.0),
    at=(0, 0, 500),
) -> Camera:
    """A camera that sees a target turned by `turn_deg` (about x, y, z in this order) at `at`, mm."""
    rotation = Transform.identity()
    for axis, degrees in zip(np.eye(3), turn_deg, strict=True):
        rotation = Transform.from_rotation_vector(axis * np.radians(degrees), np.zeros(3)) @ rotation
    return Camera(
        name="test",
        size_wh=size_wh,
        matrix=np.array([[focal_px, 0, size_wh[0] / 2 - 3.3], [0, focal_px, size_wh[1] / 2 + 2.1], [0, 0, 1]]),
        distortion=np.array(distortion),
        camera_from_world=Transform(rotation=rotation.rotation.copy(), translation_mm=np.array(at, float)),
    )


def centred(points: np.ndarray) -> Transform:
    """Target frame moved so that the middle of its points is the origin."""
    return Transform(rotation=np.eye(3), translation_mm=-(points.min(axis=0) + points.max(axis=0)) / 2)


def photograph_of_board(view: Camera, reflectance: Callable, *, sigma_px=0.7) -> Photograph:
    """Photograph of the plane z = 0 of the camera's world, whose reflectance at x, y (mm) is given."""
    return develop(radiance_of_board(view, reflectance), sigma_px)


def radiance_of_board(view: Camera, reflectance: Callable) -> np.ndarray:
    """What `develop` makes a photograph of: linear light on the finer raster."""
    centre, rays = view.centre_world, _rays(view)
    distance = -centre[2] / rays[..., 2]
    points = centre + rays * distance[..., None]
    return np.where(distance > 0, reflectance(points[..., 0], points[..., 1]), SURROUND)


def photograph_of_cylinder(
    view: Camera, target: DottedCylinderTarget, labels: np.ndarray, *, sigma_px=0.8
) -> Photograph:
    """Photograph of a dotted cylinder whose frame is the camera's world; `labels` are 8 × 8 dark cells a column."""
    c, d = view.centre_world, _rays(view)
    a = (d[..., :2] ** 2).sum(axis=-1)
    b = d[..., :2] @ c[:2]
    inside = b * b - a * (c[:2] @ c[:2] - target.radius_mm**2)
    hit = inside > 0
    distance = (-b - np.sqrt(np.where(hit, inside, 0.0))) / a
    points = c + d * distance[..., None]
    arc = (np.arctan2(points[..., 1], points[..., 0]) % (2 * np.pi)) * target.radius_mm
    column, row = arc / target.column_pitch_mm, points[..., 2] / target.row_pitch_mm
    near_column, near_row = np.rint(column), np.rint(row)
    half = target.dot_mm / 2
    dot = (np.abs(column - near_column) * target.column_pitch_mm < half) & (
        np.abs(row - near_row) * target.row_pitch_mm < half
    )
    dot &= (near_row >= 0) & (near_row < target.dots[0]) & (near_column < target.dots[1])
    # Labels: 8 × 8 cells over 0.6 of a pitch, centred 0.9 of a pitch beyond the last row.
    i = np.floor((row - (target.dots[0] - 1) - 0.6) / 0.6 * 8).astype(int)
    j = np.floor((column - near_column + 0.3) / 0.6 * 8).astype(int)
    on_label = (i >= 0) & (i < 8) & (j >= 0) & (j < 8) & (near_column < target.dots[1])
    label = labels[np.clip(near_column, 0, target.dots[1] - 1).astype(int), np.clip(i, 0, 7), np.clip(j, 0, 7)]
    end = (row < -1.5) | (row > target.dots[0] + 1)
    bright = np.where(dot | (on_label & label), DARK, BRIGHT)
    return develop(np.where(hit & ~end, bright, SURROUND), sigma_px)


def _rays(view: Camera) -> np.ndarray:
    width, height = view.size_wh
    u = (np.arange(width * FINE) + 0.5) / FINE - 0.5
    v = (np.arange(height * FINE) + 0.5) / FINE - 0.5
    rays = np.empty((height * FINE, width * FINE, 3))
    for band in np.array_split(np.arange(len(v)), 8):
        uv = np.stack(np.meshgrid(u, v[band]), axis=-1)
        rays[band] = view.rays_world(uv)
    return rays


def develop(fine: np.ndarray, sigma_px: float = 0.7, *, noise=0.0, seed=1, bits=8) -> Photograph:
    """Blur, sample, add noise, encode."""
    blurred = gaussian_filter(fine.astype(np.float32), sigma_px * FINE, truncate=4.0)
    height, width = (side // FINE for side in fine.shape)
    linear = blurred.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
    linear = np.clip(linear + noise * np.random.default_rng(seed).normal(size=linear.shape), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    top = 2**bits - 1
    pixels = np.rint(encoded * top).astype(np.uint8 if bits == 8 else np.uint16)
    return Photograph(name="test.png", pixels=np.repeat(pixels[..., None], 3, axis=2))


def chessboard(target: ChessboardTarget) -> Callable:
    columns, rows = target.squares

    def reflectance(x, y):
        i, j = np.floor(x / target.square_mm), np.floor(y / target.square_mm)
        on = (i >= 0) & (j >= 0) & (i < columns) & (j < rows)
        border = (i >= -1) & (j >= -1) & (i <= columns) & (j <= rows)
        return np.where(on & ((i + j) % 2 == 0), DARK, np.where(border, BRIGHT, SURROUND))

    return reflectance


def charuco(target: CharucoTarget) -> Callable:
    """Squares exactly; the markers from OpenCV's own picture of the board."""
    columns, rows = target.squares
    px = round(target.square_mm * MARKER_PX_PER_MM)
    picture = charuco_board(target).generateImage((columns * px, rows * px), marginSize=0, borderBits=1)
    squares = chessboard(ChessboardTarget(squares=target.squares, square_mm=target.square_mm))
    half = target.marker_mm / 2 + 0.2

    def reflectance(x, y):
        value = squares(x, y)
        i, j = np.floor(x / target.square_mm), np.floor(y / target.square_mm)
        on = (i >= 0) & (j >= 0) & (i < columns) & (j < rows) & ((i + j) % 2 == 1)
        middle = (np.abs(x - (i + 0.5) * target.square_mm) < half) & (np.abs(y - (j + 0.5) * target.square_mm) < half)
        column = np.clip(x / target.square_mm * px, 0, picture.shape[1] - 1).astype(int)
        row = np.clip(y / target.square_mm * px, 0, picture.shape[0] - 1).astype(int)
        return np.where(on & middle, np.where(picture[row, column] < 128, DARK, BRIGHT), value)

    return reflectance


def distance_mm(centres: np.ndarray, x: np.ndarray, y: np.ndarray, cell_mm: float) -> np.ndarray:
    """Distance of each point from the centre that is nearest to the middle of its cell.

    That is the nearest centre, but for points whose nearest two are alike to within a cell: none of those is in a dot.
    """
    low = np.array([x.min(), y.min()])
    count = np.ceil((np.array([x.max(), y.max()]) - low) / cell_mm).astype(int) + 1
    middles = np.stack(np.meshgrid(*((np.arange(n) + 0.5) * cell_mm for n in count), indexing="ij"), axis=-1) + low
    near = centres[cKDTree(centres).query(middles)[1]]
    near = near[((x - low[0]) / cell_mm).astype(np.int32), ((y - low[1]) / cell_mm).astype(np.int32)]
    return np.hypot(x - near[..., 0], y - near[..., 1])


def circles(target: CirclesTarget) -> Callable:
    centres = target.points_target[:, :2]
    low, high = centres.min(axis=0) - target.pitch_mm, centres.max(axis=0) + target.pitch_mm

    def reflectance(x, y):
        value = np.where((x > low[0]) & (y > low[1]) & (x < high[0]) & (y < high[1]), BRIGHT, SURROUND)
        return np.where(distance_mm(centres, x, y, target.diameter_mm / 8) < target.diameter_mm / 2, DARK, value)

    return reflectance


def mirrored(photograph: Photograph) -> Photograph:
    return Photograph(name=photograph.name, pixels=np.ascontiguousarray(photograph.pixels[:, ::-1]))


def turned(photograph: Photograph, quarters: int) -> Photograph:
    return Photograph(name=photograph.name, pixels=np.ascontiguousarray(np.rot90(photograph.pixels, quarters)))


def read(path) -> Photograph:
    """Photograph from a file, RGB."""
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR)
    return Photograph(name=path.name, pixels=np.ascontiguousarray(pixels[..., ::-1]))
