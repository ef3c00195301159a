"""Quick photographs of the telephone's board alone, from an arc around it."""

import cv2
import numpy as np
from PIL import Image

from mammometry.calibration.targets.kinds.charuco import charuco_board
from mammometry.calibration.targets.table import target_from_table
from mammometry.walk.region import TELEPHONE_BOARD

BOARD = target_from_table(TELEPHONE_BOARD)
SIZE_WH, FOCAL_PX, MIDDLE = (1200, 900), 960.0, (611.0, 441.0)
_PX_PER_MM, _MARGIN_MM, _FINE = 6, 12, 2
_MAKE, _MODEL, _ORIENTATION = 271, 272, 274
_EXIF = 0x8769
_FOCAL, _FOCAL_35, _ZOOM, _RENDERED, _EXPOSURE = 0x920A, 0xA405, 0xA404, 0xA401, 0x829A


def arc(count):
    """Azimuth and elevation of each photograph, degrees."""
    half = (count + 1) // 2
    return [(azimuth, height) for height in (-12.0, 16.0) for azimuth in np.linspace(-45, 45, half)][:count]


def photograph(azimuth_deg, elevation_deg, *, roll_deg=0.0, zoom=1.0, blur_px=0.0, distance_mm=620.0, sheet=None):
    """RGB of the board from a direction. The telephone is turned about its axis by the roll."""
    sheet = printed_sheet() if sheet is None else sheet
    a, e, roll = np.radians([azimuth_deg, elevation_deg, roll_deg])
    away = np.array([np.sin(a) * np.cos(e), -np.sin(e), -np.cos(a) * np.cos(e)])
    ahead = -away
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    rows = np.stack([right, np.cross(ahead, right), ahead])
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    rotation = turn @ rows
    centre = np.array([*BOARD.extent_mm.mean(axis=0), 0.0]) + distance_mm * away
    focal = FOCAL_PX * zoom
    matrix = np.array([[focal, 0, MIDDLE[0]], [0, focal, MIDDLE[1]], [0, 0, 1]])
    from_board = matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], -rotation @ centre])
    from_sheet = np.array([[1 / _PX_PER_MM, 0, -_MARGIN_MM + 0.5 / _PX_PER_MM],
                           [0, 1 / _PX_PER_MM, -_MARGIN_MM + 0.5 / _PX_PER_MM], [0, 0, 1]])  # fmt: skip
    fine = np.array([[_FINE, 0, (_FINE - 1) / 2], [0, _FINE, (_FINE - 1) / 2], [0, 0, 1]])
    size = (SIZE_WH[0] * _FINE, SIZE_WH[1] * _FINE)
    image = cv2.warpPerspective(sheet, fine @ from_board @ from_sheet, size, flags=cv2.INTER_AREA, borderValue=90)
    image = cv2.GaussianBlur(image, (0, 0), _FINE * (0.6 + blur_px))
    small = image.reshape(SIZE_WH[1], _FINE, SIZE_WH[0], _FINE).mean(axis=(1, 3))
    return np.repeat(np.rint(small).astype(np.uint8)[..., None], 3, axis=2)


def printed_sheet():
    """Grey levels of the board on its paper."""
    width, height = (round(side * _PX_PER_MM) for side in BOARD.extent_mm[1])
    board = charuco_board(BOARD).generateImage((width, height), marginSize=0, borderBits=1)
    margin = _MARGIN_MM * _PX_PER_MM
    return np.pad((40 + board * (180 / 255)).astype(np.uint8), margin, constant_values=220)


def save(path, pixels, *, model="One", orientation=1, focal_35=26, zoom=None, rendered=None, exposure_s=0.01):
    """Write a photograph with a telephone's tags. Without a model it has none."""
    exif = Image.Exif()
    if model:
        exif[_MAKE], exif[_MODEL], exif[_ORIENTATION] = "Maker", model, orientation
        own = {_FOCAL: 5.7, _FOCAL_35: focal_35, _EXPOSURE: exposure_s, _ZOOM: zoom, _RENDERED: rendered}
        exif.get_ifd(_EXIF).update({tag: value for tag, value in own.items() if value is not None})
    kept = {"quality": 95} if path.suffix == ".jpg" else {}
    Image.fromarray(np.ascontiguousarray(pixels)).save(path, exif=exif, **kept)
    return path
