"""Photographs as VL Photographic Image objects.

A baseline JPEG is taken over as it is, without its tags. Others are written as plain 8-bit RGB.
"""

from pathlib import Path

import numpy as np
from pydicom import Dataset
from pydicom.encaps import encapsulate
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, JPEGBaseline8Bit, VLPhotographicImageStorage

from mammometry.base.photograph import Photograph
from mammometry.hospital.codes import BREAST
from mammometry.hospital.dicom.frame import Study, begun, coded, finished
from mammometry.io.photographs.tags import Jpeg, without_tags


def photographs(study: Study, *, series: int) -> list[Dataset]:
    """Every photograph of the capture, one object a camera."""
    made = []
    for number, camera in enumerate(study.exported.photographs, 1):
        path = study.exported.photograph_files.get(camera)
        jpeg = None if path is None else baseline(path)
        place = ("photographs", series, "Photographs")
        if jpeg is not None:
            picture = image(study, jpeg, series=place, instance=number)
        else:
            picture = image(study, study.exported.photographs[camera], series=place, instance=number)
        picture.ImageComments = f"camera {camera}"
        made.append(finished(picture, picture.file_meta.TransferSyntaxUID))
    return made


def texture(study: Study, *, series: int) -> Dataset | None:
    """The picture that covers the surface. None if it is left out."""
    if study.exported.covered is None:
        return None
    jpeg = without_tags(study.exported.covered.jpeg)
    assert jpeg is not None  # we wrote it ourselves
    made = image(study, jpeg, series=("texture", series, "Picture that covers the surface"), instance=1)
    made.ImageType = ["DERIVED", "SECONDARY"]
    return finished(made, made.file_meta.TransferSyntaxUID)


def image(study: Study, source: Jpeg | Photograph, *, series: tuple[str, int, str], instance: int) -> Dataset:
    """Begin a VL Photographic Image."""
    kind, number, title = series
    made = begun(
        study,
        sop_class=VLPhotographicImageStorage,
        modality="XC",
        kind=kind,
        number=number,
        title=title,
        instance=instance,
    )
    made.ImageType = ["ORIGINAL", "PRIMARY"]
    made.AcquisitionDateTime = study.day
    made.AcquisitionContextSequence = Sequence([])
    made.AnatomicRegionSequence = Sequence([coded(BREAST)])
    made.PatientOrientation = ["", ""]
    made.BurnedInAnnotation = "NO"
    made.RecognizableVisualFeatures = "YES"
    made.BitsAllocated = made.BitsStored = 8
    made.HighBit = 7
    made.PixelRepresentation = 0
    if isinstance(source, Jpeg):
        _put_jpeg(made, source)
    else:
        _put_pixels(made, source)
    return made


def baseline(path: Path) -> Jpeg | None:
    """A file that is an upright baseline JPEG. None for any other."""
    from PIL import Image

    from mammometry.io.photographs.images import exif_of

    if path.suffix.lower() not in (".jpg", ".jpeg"):
        return None
    with Image.open(path, formats=("JPEG", "MPO")) as opened:
        if exif_of(opened, path).get(274, 1) != 1 or opened.mode not in ("L", "RGB"):  # tag 274: orientation
            return None
    jpeg = without_tags(path.read_bytes())
    return jpeg if jpeg is not None and jpeg.baseline else None


def _put_jpeg(made: Dataset, jpeg: Jpeg) -> None:
    made.Columns, made.Rows = jpeg.size_wh
    made.SamplesPerPixel = jpeg.components
    if jpeg.components == 3:
        made.PlanarConfiguration = 0
        made.PhotometricInterpretation = "YBR_FULL_422"  # the only one of JPEG in PS3.3, C.8.12.1.1.1, however sampled
    else:
        made.PhotometricInterpretation = "MONOCHROME2"
    made.LossyImageCompression = "01"
    made.LossyImageCompressionMethod = "ISO_10918_1"
    raw = jpeg.size_wh[0] * jpeg.size_wh[1] * jpeg.components
    made.LossyImageCompressionRatio = f"{raw / len(jpeg.content):.2f}"
    made.PixelData = encapsulate([jpeg.content])
    made["PixelData"].VR = "OB"
    made["PixelData"].is_undefined_length = True
    _remember(made, JPEGBaseline8Bit)


def _put_pixels(made: Dataset, photograph: Photograph) -> None:
    pixels = photograph.pixels
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    made.Rows, made.Columns = pixels.shape[:2]
    if pixels.ndim == 3:
        made.SamplesPerPixel, made.PlanarConfiguration = 3, 0
        made.PhotometricInterpretation = "RGB"
    else:
        made.SamplesPerPixel = 1
        made.PhotometricInterpretation = "MONOCHROME2"
    made.LossyImageCompression = "00"
    data = np.ascontiguousarray(pixels).tobytes()
    made.PixelData = data + b"\0" * (len(data) % 2)
    made["PixelData"].VR = "OB"
    _remember(made, ExplicitVRLittleEndian)


def _remember(made: Dataset, transfer_syntax: str) -> None:
    from pydicom.dataset import FileMetaDataset
    from pydicom.uid import UID

    made.file_meta = FileMetaDataset()
    made.file_meta.TransferSyntaxUID = UID(transfer_syntax)
