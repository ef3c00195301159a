"""Select the pictures of a folder that belong to one walk, by their files' metadata.

The adjustment assumes one lens, so the walk consists of the pictures with the most frequent telephone, size and zoom.
The others are left out and listed, as are pictures that software composed or blurred.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from typing import Literal, TypeAlias, TypeVar

from mammometry.base.errors import CalibrationError
from mammometry.base.value import value

Mode: TypeAlias = Literal["", "portrait", "panorama"]
_Key = TypeVar("_Key", bound=Hashable)
_LONGEST_EXPOSURE_S = 0.25
"""In this time a standing body sways by 0.5 mm (2 mm/s). Night modes take 1 s or more."""
_WIDEST = 2.5
"""Largest ratio of width to height: screens have up to 2.33 (21:9), panoramas 3 or more."""
_SAME_ZOOM = 0.04
"""Largest relative difference of focal lengths in EXIF without a zoom: they are rounded to whole mm, of about 26 mm."""
_LEAST_QUALITY = 50.0
"""Of a JPEG: at 50, the points of a pair have twice the error of the original, at 40 three times (decision 52)."""


@value
class PictureFacts:
    """How a picture was taken, from its file's metadata. Unknown values are empty or None."""

    stored_wh: tuple[int, int]
    """Width and height of the sensor's picture, before it is rotated, pixels."""
    orientation: int = 1
    """EXIF orientation, 1…8."""
    is_png: bool = False
    """Screenshots are PNG files. Photographs by telephones are not."""
    model: str = ""
    """Make and model of the telephone."""
    focal_mm: float | None = None
    """Focal length of the lens."""
    focal_35_mm: float | None = None
    """35 mm equivalent focal length. Digital zoom changes it, too."""
    zoom: float | None = None
    """Digital zoom."""
    exposure_s: float | None = None
    """Exposure time."""
    jpeg_quality: float | None = None
    """Quality of the last compression, 1…100, on libjpeg's scale. Telephones write 85 to 98."""
    mode: Mode = ""
    """Camera mode in which software composes or blurs the picture."""


@value
class LeftOut:
    """Why a picture is not used."""

    code: str
    """Kind of the reason, for programs. It never changes."""
    found: str
    expected: str = ""
    """What was expected instead. Empty if `found` says it."""
    remedy: str = ""
    """What the user can do. Empty if nothing is wrong."""

    def __str__(self) -> str:
        """One or two sentences."""
        text = f"{self.found}, expected {self.expected}" if self.expected else self.found
        return f"{text}. {self.remedy}" if self.remedy else text


def judge_files(facts: Mapping[str, PictureFacts]) -> dict[str, LeftOut]:
    """Pictures that do not belong to the walk, with reasons.

    Args:
        facts: number of a picture → how it was taken.
    """
    out: dict[str, LeftOut] = {}
    for judge in (_modes, _telephones, _sizes, _zooms, _compressed):
        out |= judge({name: of for name, of in facts.items() if name not in out})
    return out


def require_enough(left: Collection[str], out: Mapping[str, LeftOut], names: Mapping[str, str], fewest: int) -> None:
    """Refuse a walk with too few usable pictures.

    Args:
        left: numbers of the usable pictures.
        out: number → why it is not usable.
        names: number → file, for messages.
        fewest: least number of usable pictures.

    Raises:
        CalibrationError: too few are usable. `details` has one line for each of the others.
    """
    if len(left) >= fewest:
        return
    example, expected, remedy = "", f"at least {fewest}", "Take 20 to 30 photographs of the walk"
    if out:
        usual = _usual([why.code for why in out.values()])
        name, why = next((name, why) for name, why in out.items() if why.code == usual)
        example = f" ({names[name]}: {why.found})"
        expected += f"; {why.expected}" if why.expected else ""
        remedy = why.remedy or "Keep the whole board in the picture, in focus"
    error = CalibrationError(
        "the photographs",
        found=f"{len(left)} usable of {len(left) + len(out)}{example}",
        expected=expected,
        remedy=remedy,
    )
    error.details = tuple(f"{names[number]}: {reason}" for number, reason in out.items())
    raise error


def usual_orientation(facts: Mapping[str, PictureFacts]) -> int:
    """The most frequent EXIF orientation.

    All pictures are rotated by it, because the lens is fixed to the sensor.
    """
    return _usual([of.orientation for of in facts.values()]) or 1


def _modes(facts: Mapping[str, PictureFacts]) -> dict[str, LeftOut]:
    out = {}
    for name, of in facts.items():
        width, height = max(of.stored_wh), min(of.stored_wh)
        if of.mode == "panorama" or width > _WIDEST * height:
            out[name] = LeftOut(
                code="panorama",
                found=f"a panorama of {of.stored_wh[0]} × {of.stored_wh[1]} pixels",
                expected="single pictures",
                remedy="Use the camera's ordinary photo mode",
            )
        elif of.mode == "portrait":
            out[name] = LeftOut(
                code="portrait-mode",
                found="portrait mode, in which software blurs the picture",
                expected="ordinary pictures",
                remedy="Use the camera's ordinary photo mode",
            )
        elif of.exposure_s is not None and of.exposure_s >= _LONGEST_EXPOSURE_S:
            out[name] = LeftOut(
                code="long-exposure",
                found=f"an exposure of {of.exposure_s:.2g} s",
                expected=f"less than {_LONGEST_EXPOSURE_S:g} s",
                remedy="Switch off night mode, and use more light",
            )
    return out


def _telephones(facts: Mapping[str, PictureFacts]) -> dict[str, LeftOut]:
    usual = _usual([of.model for of in facts.values() if of.model])
    return {
        name: LeftOut(
            code="another-telephone",
            found=f"taken with {of.model}",
            expected=f"{usual}, like most pictures",
            remedy="Take all pictures of a walk with one telephone",
        )
        for name, of in facts.items()
        if usual is not None and of.model not in ("", usual)
    }


def _sizes(facts: Mapping[str, PictureFacts]) -> dict[str, LeftOut]:
    usual = _usual([of.stored_wh for of in facts.values()])
    by_camera = any(of.model for of in facts.values())
    out = {}
    for name, of in facts.items():
        if usual is None or of.stored_wh == usual:
            continue
        code, remedy = "other-size", "Copy the original files from the telephone: no messenger, no cropping"
        if of.is_png and not of.model and by_camera:
            code, remedy = "screenshot", "Copy the picture itself, not a picture of the screen"
        elif of.stored_wh == usual[::-1]:
            code, remedy = "turned", "Copy the original files from the telephone: other programs rotate the pixels"
        out[name] = LeftOut(
            code=code,
            found=f"{of.stored_wh[0]} × {of.stored_wh[1]} pixels",
            expected=f"{usual[0]} × {usual[1]}, like most pictures",
            remedy=remedy,
        )
    return out


def _zooms(facts: Mapping[str, PictureFacts]) -> dict[str, LeftOut]:
    """Compare three tags: focal length, digital zoom, and the 35 mm equivalent."""
    out: dict[str, LeftOut] = {}
    kinds: Sequence[tuple[str, Callable[[PictureFacts], float | None]]] = (
        ("a lens of {:.3g} mm", lambda of: of.focal_mm),
        ("digital zoom {:.3g}", lambda of: of.zoom),
        ("a 35 mm equivalent focal length of {:.3g} mm", lambda of: of.focal_35_mm),
    )
    for words, of_picture in kinds:
        known = {name: tag for name, of in facts.items() if name not in out and (tag := of_picture(of)) is not None}
        usual = _usual(list(known.values()))
        out |= {
            name: LeftOut(
                code="zoom",
                found=words.format(tag),
                expected=f"{usual:.3g}, like most pictures",
                remedy="Do not zoom during a walk, and keep the telephone from switching lenses",
            )
            for name, tag in known.items()
            if usual is not None and abs(tag / usual - 1) > _SAME_ZOOM
        }
    return out


def _compressed(facts: Mapping[str, PictureFacts]) -> dict[str, LeftOut]:
    return {
        name: LeftOut(
            code="compressed",
            found=f"a JPEG of quality {of.jpeg_quality:.0f}, which lacks the skin's fine texture",
            expected=f"at least {_LEAST_QUALITY:.0f}",
            remedy="Copy the original files from the telephone: messengers and other programs compress them",
        )
        for name, of in facts.items()
        if of.jpeg_quality is not None and of.jpeg_quality < _LEAST_QUALITY
    }


def _usual(values: Sequence[_Key]) -> _Key | None:
    """The most frequent value; the first one if several are. None without values."""
    return Counter(values).most_common(1)[0][0] if values else None
