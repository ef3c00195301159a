"""All objects of a session's study: photographs, and report and models as encapsulated documents.

Photographs are VL Photographic Image objects. A baseline JPEG is kept unchanged, without its tags. Others are
written as plain 8-bit RGB.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydicom import Dataset
from pydicom.encaps import encapsulate
from pydicom.sequence import Sequence
from pydicom.uid import (
    UID,
    EncapsulatedMTLStorage,
    EncapsulatedOBJStorage,
    EncapsulatedPDFStorage,
    EncapsulatedSTLStorage,
    ExplicitVRLittleEndian,
    JPEGBaseline8Bit,
    VLPhotographicImageStorage,
)

from mammometry.base.photograph import Photograph
from mammometry.hospital.codes import BREAST, UNITS, Coded, uid
from mammometry.hospital.dicom import structured
from mammometry.hospital.dicom.frame import Study, begun, coded, encoded, finished
from mammometry.hospital.exported import Exported, ExportedPatient, Order, Side, as_patient_id, person_name
from mammometry.io.photographs.tags import Jpeg, without_tags


def photographs(study: Study, *, series: int) -> list[Dataset]:
    """Every photograph of the capture, one object per camera."""
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
    """The texture of the surface. None if it is left out."""
    if study.exported.covered is None:
        return None
    jpeg = without_tags(study.exported.covered.jpeg)
    assert jpeg is not None  # written by us
    made = image(study, jpeg, series=("texture", series, "Texture of the surface"), instance=1)
    made.ImageType = ["DERIVED", "SECONDARY"]
    return finished(made, made.file_meta.TransferSyntaxUID)


def image(study: Study, source: Jpeg | Photograph, *, series: tuple[str, int, str], instance: int) -> Dataset:
    """Create a VL Photographic Image."""
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
    _lateral(made, study)
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


def _lateral(made: Dataset, study: Study) -> None:
    """State that a picture of a trunk shows both breasts.

    The breast is a paired structure, so Image Laterality or, at least empty, Laterality is required (PS3.3, Table
    C.7-5a, type 2C). A cast's side is not known.
    """
    if study.exported.kind == "torso":
        made.ImageLaterality = "B"
    else:
        made.Laterality = ""


def baseline(path: Path) -> Jpeg | None:
    """Content of an upright baseline JPEG. None for any other file."""
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
        made.PhotometricInterpretation = (
            "YBR_FULL_422"  # the only one for JPEG in PS3.3, C.8.12.1.1.1, for any subsampling
        )
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


_MODEL = Coded(value="129020", scheme="DCM", meaning="Photogrammetric Imaging 3D CAM model")  # CID 7061
_REPORT = Coded(value="126000", scheme="DCM", meaning="Imaging Measurement Report")  # CID 7021
_LATERALITY = {"left": "L", "right": "R"}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Kind:
    """One kind of encapsulated document."""

    sop_class: UID
    mime: str
    modality: str
    concept: Coded


_PDF = _Kind(sop_class=EncapsulatedPDFStorage, mime="application/pdf", modality="DOC", concept=_REPORT)
_STL = _Kind(sop_class=EncapsulatedSTLStorage, mime="model/stl", modality="M3D", concept=_MODEL)
_OBJ = _Kind(sop_class=EncapsulatedOBJStorage, mime="model/obj", modality="M3D", concept=_MODEL)
_MTL = _Kind(sop_class=EncapsulatedMTLStorage, mime="model/mtl", modality="M3D", concept=_MODEL)


def report(study: Study, *, series: int) -> list[Dataset]:
    """The report as Encapsulated PDF. Empty without one."""
    pdf = study.exported.report_pdf
    if pdf is None:
        return []
    made = _document(study, _PDF, pdf, series=("report", series, "Report"), instance=1, title="mammometry report")
    return [finished(made)]


def models(study: Study, *, series: int) -> list[Dataset]:
    """Closed breasts and surface as Encapsulated STL."""
    made = []
    for number, solid in enumerate(study.exported.models, 1):
        model = _document(
            study, _STL, solid.stl, series=("models", series, "Models, STL"), instance=number, title=solid.title
        )
        _of_side(model, solid.side)
        _manufacturing(model, study, solid.title)
        made.append(finished(model))
    return made


def covered(study: Study, texture: Dataset, *, series: int) -> list[Dataset]:
    """Textured models as Encapsulated OBJ, and their MTL. The MTL names the texture."""
    files = study.exported.covered
    if files is None:
        return []
    place = ("covered", series, "Models with photographs, OBJ")
    mtl = _document(
        study, _MTL, files.mtl, series=place, instance=len(files.models) + 1, title="Material of the models"
    )
    mtl.ReferencedInstanceSequence = Sequence([_named(texture, "model.jpg")])
    mtl = finished(mtl)
    made = []
    for number, coloured in enumerate(files.models, 1):
        title = f"{coloured.title}, with photographs"
        obj = _document(study, _OBJ, coloured.obj, series=place, instance=number, title=title)
        obj.ReferencedInstanceSequence = Sequence([_named(mtl, "model.mtl")])
        _of_side(obj, coloured.side)
        _manufacturing(obj, study, title)
        made.append(finished(obj))
    return [*made, mtl]


def _document(
    study: Study, kind: _Kind, content: bytes, *, series: tuple[str, int, str], instance: int, title: str
) -> Dataset:
    name, number, series_title = series
    made = begun(
        study,
        sop_class=kind.sop_class,
        modality=kind.modality,
        kind=name,
        number=number,
        title=series_title,
        instance=instance,
    )
    if kind is _PDF:
        made.ConversionType = "WSD"  # by a workstation
    made.AcquisitionDateTime = study.day
    made.BurnedInAnnotation = "YES" if kind is _PDF and not study.exported.deidentified else "NO"
    # A bare trunk, or its shape, may be recognised without a face.
    made.RecognizableVisualFeatures = "YES"
    made.DocumentTitle = title
    made.ConceptNameCodeSequence = Sequence([coded(kind.concept)])
    made.MIMETypeOfEncapsulatedDocument = kind.mime
    made.EncapsulatedDocumentLength = len(content)
    made.EncapsulatedDocument = content + b"\0" * (len(content) % 2)
    return made


def _of_side(made: Dataset, side: Side) -> None:
    if side in _LATERALITY:
        made.ImageLaterality = _LATERALITY[side]


def _manufacturing(made: Dataset, study: Study, title: str) -> None:
    """Frame of Reference and Manufacturing 3D Model modules (PS3.3, C.35.1)."""
    made.FrameOfReferenceUID = study.frame_uid
    made.PositionReferenceIndicator = ""
    made.MeasurementUnitsCodeSequence = Sequence([coded(UNITS["mm"])])
    made.ModelModification = "NO"
    made.ModelMirroring = "NO"
    made.ContentDescription = title
    made.ModelGroupUID = uid("models", study.uid)


def _named(target: Dataset, name: str) -> Dataset:
    """A reference from a document to another object, by its name in the document."""
    item = Dataset()
    item.ReferencedSOPClassUID = target.SOPClassUID
    item.ReferencedSOPInstanceUID = target.SOPInstanceUID
    item.RelativeURIReferenceWithinEncapsulatedDocument = name
    return item


def objects(exported: Exported, patient: ExportedPatient = ExportedPatient(), order: Order = Order()) -> list[Dataset]:
    """Make the objects of a session, one series per kind.

    The same session, patient and order give the same bytes.

    Args:
        exported: the content. If it is de-identified, patient and order are left out.
        patient: as in other systems. Without an id, the session's subject is used.
        order: the order.
    """
    if exported.deidentified:
        patient, order = ExportedPatient(id=f"anonymous-{exported.source[:12]}", name="Anonymous^"), Order()
    elif not patient.id:
        patient = ExportedPatient(
            id=as_patient_id(exported.subject),
            name=patient.name or person_name(exported.subject)[:64],
            born=patient.born,
            sex=patient.sex,
        )
    study = Study(exported=exported, patient=patient, order=order)
    pages, solids = report(study, series=1), models(study, series=3)
    picture = texture(study, series=5)
    skins = [] if picture is None else [*covered(study, picture, series=4), picture]
    pictures = photographs(study, series=6)
    measured = structured.report(study, pictures or solids or pages, series=2)
    return [*pages, *measured, *solids, *skins, *pictures]


def possible_names(photographs: int) -> list[str]:
    """Names of all possible files of a session."""
    counts = (("01-DOC", 1), ("02-SR", 1), ("03-M3D", 4), ("04-M3D", 4), ("05-XC", 1), ("06-XC", photographs))
    return [f"{kind}-{number:03d}.dcm" for kind, count in counts for number in range(1, count + 1)]


def files(made: list[Dataset]) -> dict[str, bytes]:
    """Name of a file → its content. Names contain series and instance."""
    return {
        f"{dataset.SeriesNumber:02d}-{dataset.Modality}-{dataset.InstanceNumber:03d}.dcm": encoded(dataset)
        for dataset in made
    }
