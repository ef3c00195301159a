"""Limits on the size of the user's files.

A larger file is refused by its header, before memory is allocated for it.
"""

from __future__ import annotations

from dataclasses import dataclass

_OPENCV_MEGAPIXELS = 1000.0  # OpenCV, which decodes 16-bit photographs, reads no more than 2³⁰ pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitSettings:
    """Sizes up to which files are read. No result depends on them."""

    megapixels: float = 200.0
    """Largest photograph or mask, millions of pixels. The largest medium-format sensors have 151. 200 of them take 0.6
    GB at 8 bits a channel, 1.2 GB at 16.
    """

    def __post_init__(self) -> None:
        if not 0 < self.megapixels <= _OPENCV_MEGAPIXELS:
            raise ValueError(f"megapixels must lie between 0 and {_OPENCV_MEGAPIXELS:g}, found {self.megapixels}")
