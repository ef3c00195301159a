"""Quick photographs of the telephone's board alone, from an arc around it."""

import cv2
import numpy as np
from PIL import Image

from mammometry.calibration.targets.card_field import field_sheet
from mammometry.calibration.targets.kinds.charuco import charuco_board
from mammometry.calibration.targets.table import target_from_table
from mammometry.walk.region import TELEPHONE_BOARD

BOARD = target_from_table(TELEPHONE_BOARD)
SIZE_WH, FOCAL_PX, MIDDLE = (1200, 900), 960.0, (611.0, 441.0)
_PX_PER_MM, _MARGIN_MM, _FINE = 6, 32, 2
_INK, _PAPER, _ROOM = 0.03, 0.7, 0.1  # linear light
_MAKE, _MODEL, _ORIENTATION = 271, 272, 274
_EXIF = 0x8769
_FOCAL, _FOCAL_35, _ZOOM, _RENDERED, _EXPOSURE = 0x920A, 0xA405, 0xA404, 0xA401, 0x829A


def arc(count):
    """Azimuth and elevation of each photograph, degrees."""
    half = (count + 1) // 2
    return [(azimuth, height) for height in (-12.0, 16.0) for azimuth in np.linspace(-45, 45, half)][:count]


def photograph(
    azimuth_deg, elevation_deg, *, roll_deg=0.0, zoom=1.0, blur_px=0.0, distance_mm=620.0, sheet=None, card=None
):
    """RGB of the board from a direction. The telephone is turned about its axis by the roll.

    A card has `middle`, `turn_rad`, `size_mm` and `thick_mm`, and `grey` and `wall` in linear light.
    """
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
    image = cv2.warpPerspective(sheet, fine @ from_board @ from_sheet, size, flags=cv2.INTER_LINEAR, borderValue=_ROOM)
    if card is not None:
        mask, top, whole = card_mask(card), 0.0, 0.0
        for share in (0.0, 0.5, 1.0):  # of the side wall's height
            z = -card["thick_mm"] * share
            from_plane = matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], rotation @ ([0, 0, z] - centre)])
            top = cv2.warpPerspective(mask, fine @ from_plane @ from_sheet, size, flags=cv2.INTER_LINEAR)
            whole = np.maximum(whole, top)
        image = (1 - whole) * image + (whole - top) * card["wall"] + top * card["grey"]
    image = cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), _FINE * (0.6 + blur_px))
    small = image.reshape(SIZE_WH[1], _FINE, SIZE_WH[0], _FINE).mean(axis=(1, 3))
    encoded = np.where(small <= 0.0031308, 12.92 * small, 1.055 * small ** (1 / 2.4) - 0.055)
    return np.repeat(np.rint(255 * encoded).astype(np.uint8)[..., None], 3, axis=2)


def card_mask(card):
    """Share of each pixel of the sheet that a card covers, 0 to 1."""
    width, height = (round((side + 2 * _MARGIN_MM) * _PX_PER_MM) for side in BOARD.extent_mm[1])
    x, y = np.meshgrid(*((np.arange(count) + 0.5) / _PX_PER_MM - _MARGIN_MM for count in (width, height)))
    cos, sin = np.cos(card["turn_rad"]), np.sin(card["turn_rad"])
    x, y = x - card["middle"][0], y - card["middle"][1]
    along, across = np.abs(cos * x + sin * y), np.abs(cos * y - sin * x)
    half = 0.5 * np.array(card["size_mm"])
    shares = [np.clip(0.5 + _PX_PER_MM * (side - to), 0, 1) for side, to in zip(half, (along, across), strict=True)]
    return np.prod(shares, axis=0).astype(np.float32)


def printed_sheet():
    """Linear light of the board on its paper, with the field for a card."""
    width, height = (round(side * _PX_PER_MM) for side in BOARD.extent_mm[1])
    board = charuco_board(BOARD).generateImage((width, height), marginSize=0, borderBits=1)
    margin = _MARGIN_MM * _PX_PER_MM
    sheet = np.pad(np.where(board > 0, _PAPER, _INK).astype(np.float32), margin, constant_values=_PAPER)
    for left, top, width, height in field_sheet().rectangles:
        x, y = (round((at + _MARGIN_MM) * _PX_PER_MM) for at in (left, top))
        sheet[y : y + round(height * _PX_PER_MM), x : x + round(width * _PX_PER_MM)] = _INK
    return sheet


def save(
    path, pixels, *, model="One", orientation=1, focal_35=26, zoom=None, rendered=None, exposure_s=0.01, quality=95
):
    """Write a photograph with a telephone's tags. Without a model it has none."""
    exif = Image.Exif()
    if model:
        exif[_MAKE], exif[_MODEL], exif[_ORIENTATION] = "Maker", model, orientation
        own = {_FOCAL: 5.7, _FOCAL_35: focal_35, _EXPOSURE: exposure_s, _ZOOM: zoom, _RENDERED: rendered}
        exif.get_ifd(_EXIF).update({tag: value for tag, value in own.items() if value is not None})
    kept = {"quality": quality} if path.suffix == ".jpg" else {}
    Image.fromarray(np.ascontiguousarray(pixels)).save(path, exif=exif, **kept)
    return path
