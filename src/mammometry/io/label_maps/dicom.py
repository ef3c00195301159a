"""Volumes of segments of a DICOM segmentation."""

from __future__ import annotations

from pathlib import Path

from mammometry.base.errors import SessionError
from mammometry.base.extras import require
from mammometry.base.parse import error_text, shown

SUFFIX = ".dcm"
"""Suffix of DICOM files."""


def segment_cc(path: Path, segment: str = "") -> float:
    """Volume of a segment of a DICOM segmentation, cc: number of voxels times their size.

    Args:
        path: a DICOM Segmentation object.
        segment: number or label of the segment. Empty: the only one.

    Raises:
        MissingLibraryError: the libraries for DICOM are not installed.
        SessionError: it cannot be read, or there is no such segment, or several.
    """
    require("hospital", "pydicom", "highdicom")
    import highdicom
    import numpy as np
    from pydicom.errors import InvalidDicomError

    try:
        found = highdicom.seg.segread(path)
        labels = {number: str(found.get_segment_description(number).segment_label) for number in found.segment_numbers}
        chosen = [number for number, label in labels.items() if segment in ("", str(number)) or segment == label]
        if len(chosen) == 1:
            volume = found.get_volume(segment_numbers=chosen, combine_segments=True)
            return float((np.asarray(volume.array) > 0).sum()) * float(np.prod(volume.spacing)) / 1000.0
    except (OSError, InvalidDicomError, ValueError, AttributeError, KeyError, RuntimeError) as error:
        raise SessionError(
            str(path),
            found=error_text(error),
            expected="a DICOM segmentation (SEG) with parallel, evenly spaced slices",
            remedy="Export the segmentation as DICOM SEG, or as a closed mesh",
        ) from None
    known = ", ".join(f"{number} {label}" for number, label in labels.items())
    raise SessionError(
        str(path),
        found=f"the segments {known}" + (f", none or several called {shown(segment)}" if segment else ""),
        expected="one segment",
        remedy="Give its number or label in the column segment",
    )
