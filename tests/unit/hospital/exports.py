"""Results as they are exported, made up: two breasts, lengths, a report, photographs of noise."""

import datetime
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mammometry.base.photograph import Photograph
from mammometry.hospital.exported import (
    Absent,
    CoveredModel,
    CoveredModels,
    Exported,
    ExportedMesh,
    ExportedOperation,
    ExportedPatient,
    Order,
    Quantity,
)
from mammometry.report.content import Clinical, Signed

ANNA = ExportedPatient(id="KIS-4711", name="Zypernkatze^Quirina", born=datetime.date(1980, 2, 29), sex="F")
ORDER = Order(accession="A123", study_uid="1.2.826.0.1.3680043.8.498.1", referring="House^Gregory", procedure_id="P7")
NAMES = ("KIS-4711", "Zypernkatze", "Quirina", "19800229", "1980-02-29", "P-EXAMPLE", "20260301", "2026-03-01", "House")
"""All that tells who and when."""
_GPS = 0x8825


def jpeg_with_tags(path: Path, seed: int, size_wh: tuple[int, int] = (32, 24)) -> Path:
    """A photograph as a camera writes it: with its place and its owner in it."""
    width, height = size_wh
    pixels = np.random.default_rng(seed).integers(0, 255, (height, width, 3), dtype=np.uint8)
    tags = Image.Exif()
    tags[0x013B] = "Zypernkatze"  # artist
    tags.get_ifd(_GPS)[1] = "N"
    Image.fromarray(pixels).save(path, exif=tags, quality=90, comment=b"Quirina")
    return path


def quantities() -> tuple[Quantity, ...]:
    made = []
    for side, volume in (("left", 354.25), ("right", 371.5)):
        about: dict[str, Any] = {"side": side, "boundary": "automatic: along the crease"}
        walled = {**about, "wall": "cylinder-membrane", "wall_definition": "a membrane"}
        made += [
            Quantity(
                code="volume", title="Volume", value=volume, unit="cm3", interval_95=(volume - 40.5, volume + 42.25),
                method="closed-mesh", note="The interval covers calibration.", **walled,
            ),
            Quantity(code="projection", title="Projection", value=61.5, unit="mm", method="plane-distance", **about),
            Quantity(
                code="nipple_below_fold", title="Nipple below the fold", side=side, value=-38.5, unit="mm", sigma=3.75,
                method="height",
            ),
        ]  # fmt: skip
    made.append(
        Quantity(
            code="n_n_straight", title="nipple to nipple, straight", side="", value=201.25, unit="mm", sigma=1.5,
            method="straight",
        )
    )  # fmt: skip
    return tuple(made)


def exported(folder: Path, **changed: Any) -> Exported:
    """A whole session. Its photographs lie in `folder`."""
    folder.mkdir(exist_ok=True)
    files = {"front": jpeg_with_tags(folder / "front.jpg", 1), "side": folder / "side.png"}
    noise = np.random.default_rng(2).integers(0, 255, (15, 21, 3), dtype=np.uint8)
    Image.fromarray(noise).save(files["side"])
    with Image.open(files["front"]) as opened:
        front = np.asarray(opened).copy()
    buffer = io.BytesIO()
    Image.fromarray(noise).save(buffer, "JPEG", quality=92)
    made = Exported(
        subject="P-EXAMPLE",
        kind="torso",
        taken=datetime.date(2026, 3, 1),
        made=datetime.datetime(2026, 3, 2, 10, 11, 12, tzinfo=datetime.UTC),
        software="0.1.0",
        source="ab" * 32,
        quantities=quantities(),
        report_pdf=b"%PDF-1.4 not a whole one",
        models=tuple(
            ExportedMesh(
                name=name, title=name, side=side, stl=bytes(80) + number.to_bytes(4, "little") + bytes(50 * number)
            )  # type: ignore[arg-type]
            for number, (name, side) in enumerate((("left", "left"), ("right", "right"), ("surface", "")), 1)
        ),
        covered=CoveredModels(
            models=tuple(
                CoveredModel(name=name, title=name, side=side, obj=b"mtllib model.mtl\nv 0 0 %d\n" % number)  # type: ignore[arg-type]
                for number, (name, side) in enumerate((("surface", ""), ("left", "left"), ("right", "right")))
            ),
            mtl=b"newmtl skin\nmap_Kd model.jpg\n",
            jpeg=buffer.getvalue(),
        ),
        photographs={"front": Photograph(name="front", pixels=front), "side": Photograph(name="side", pixels=noise)},
        photograph_files=files,
    )
    return replace(made, **changed)


def deidentified(folder: Path) -> Exported:
    """The same for others."""
    return exported(
        folder, subject="", taken=None, made=None, covered=None, photographs={}, photograph_files={}, deidentified=True
    )


def one_sided(folder: Path) -> Exported:
    """A patient with one breast."""
    only = tuple(each for each in quantities() if each.side != "right")
    return exported(folder, quantities=only, absent=(Absent(side="right", why="flat there", kind="none"),))


CONFIRMED = Signed(by="Dr. Rosa Luchs", at=datetime.datetime(2026, 3, 2, 11, 0, 5, tzinfo=datetime.UTC))
CONCLUDED = Signed(
    by="Prof. Egon Dachs", at=datetime.datetime(2026, 3, 3, 8, 30, tzinfo=datetime.UTC), text="Larger on the right."
)


def signed(folder: Path, *, concluded: bool = True) -> Exported:
    """A session that a clinic confirmed, and concluded of, after an operation."""
    clinical = Clinical(confirmed=CONFIRMED, conclusions=(CONCLUDED,) if concluded else ())
    operations = tuple(
        ExportedOperation(
            kind=kind, title=title, side=side, day=datetime.date(2025, 5, 6), sentence=f"{title}, 2025-05-06"
        )
        for kind, title, side in (
            ("implant", "Implant inserted", "both"),
            ("conserving", "Breast-conserving surgery", "left"),
        )
    )
    return exported(folder, clinical=clinical, operations=operations, organization="Test clinic", is_final=concluded)
