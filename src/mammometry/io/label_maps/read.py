"""Read the volume of a segment from a label map in any supported format."""

from __future__ import annotations

from pathlib import Path

from mammometry.io.label_maps import dicom
from mammometry.io.label_maps.nifti import SUFFIXES, read_nifti
from mammometry.io.label_maps.nrrd import SUFFIX, read_nrrd
from mammometry.io.label_maps.voxels import label_cc

_READERS = {SUFFIX: read_nrrd} | dict.fromkeys(SUFFIXES, read_nifti)


def is_label_map(path: Path) -> bool:
    """Whether a file is a label map, by its suffix."""
    return path.name.lower().endswith((dicom.SUFFIX, *_READERS))


def segment_cc(path: Path, segment: str = "", units: str | None = None) -> float:
    """Volume of a segment, cc: number of its voxels times their size.

    Args:
        path: a DICOM segmentation (.dcm), NRRD (.nrrd) or NIfTI (.nii, .nii.gz).
        segment: number or name of the segment. Empty: the only one.
        units: unit of the file's lengths, if it does not state one.

    Raises:
        MissingLibraryError: the libraries for DICOM are not installed.
        SessionError: it cannot be read, or there is no such segment, or several.
    """
    read = next((read for suffix, read in _READERS.items() if path.name.lower().endswith(suffix)), None)
    if read is None:
        return dicom.segment_cc(path, segment)
    return label_cc(path, read(path, units), segment)
