"""Volumes of segments of DICOM segmentations, made by highdicom from slices of known spacing."""

from pathlib import Path

import highdicom
import numpy as np
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sr.codedict import codes
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

from mammometry.base.errors import SessionError
from mammometry.io.label_maps.read import segment_cc


def slices(count: int, spacing_mm: tuple[float, float, float]) -> list[Dataset]:
    study, series, frame = generate_uid(), generate_uid(), generate_uid()
    found = []
    for place in range(count):
        image = Dataset()
        image.file_meta = FileMetaDataset()
        image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        image.SOPClassUID, image.SOPInstanceUID = CTImageStorage, generate_uid()
        image.StudyInstanceUID, image.SeriesInstanceUID, image.FrameOfReferenceUID = study, series, frame
        image.PatientID, image.PatientName = "W1", "W1^"
        for name in ("PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "AccessionNumber", "StudyID",
                     "ReferringPhysicianName", "PositionReferenceIndicator"):  # fmt: skip
            setattr(image, name, "")
        image.Modality, image.SeriesNumber, image.InstanceNumber = "CT", 1, place + 1
        image.Rows = image.Columns = 16
        image.PixelSpacing, image.SliceThickness = list(spacing_mm[1:]), spacing_mm[0]
        image.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        image.ImagePositionPatient = [0, 0, spacing_mm[0] * place]
        image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
        image.BitsAllocated = image.BitsStored = 16
        image.HighBit, image.PixelRepresentation = 15, 0
        image.PixelData = np.zeros((16, 16), np.uint16).tobytes()
        found.append(image)
    return found


def segmentation(path: Path, labels: tuple[str, ...]) -> Path:
    mask = np.zeros((6, 16, 16, len(labels)), np.uint8)
    for place in range(len(labels)):
        mask[1:5, 2 + 7 * place : 8 + 7 * place, 3:9, place] = 1
    mask[2, 2, 3, 0] = 0
    described = [
        highdicom.seg.SegmentDescription(
            number + 1, label, codes.SCT.Tissue, codes.SCT.Breast, highdicom.seg.SegmentAlgorithmTypeValues.MANUAL
        )
        for number, label in enumerate(labels)
    ]
    made = highdicom.seg.Segmentation(
        slices(6, (3.0, 2.0, 1.5)), mask, highdicom.seg.SegmentationTypeValues.BINARY, described, generate_uid(), 2,
        generate_uid(), 1, "maker", "model", "1", "1",
    )  # fmt: skip
    made.save_as(path)
    return path


@pytest.mark.requirement("R-TRUTH-2")
def test_voxels_by_their_size(tmp_path: Path) -> None:
    both = segmentation(tmp_path / "both.dcm", ("left", "right"))
    assert segment_cc(both, "left") == pytest.approx((4 * 6 * 6 - 1) * 9.0 / 1000)
    assert segment_cc(both, "2") == pytest.approx(4 * 6 * 6 * 9.0 / 1000)
    assert segment_cc(segmentation(tmp_path / "one.dcm", ("breast",))) == pytest.approx((4 * 6 * 6 - 1) * 9.0 / 1000)
    for segment in ("", "both"):
        with pytest.raises(SessionError):
            segment_cc(both, segment)


def test_what_is_no_segmentation_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.dcm").write_text("no DICOM")
    for name in ("text.dcm", "absent.dcm"):
        with pytest.raises(SessionError):
            segment_cc(tmp_path / name)
