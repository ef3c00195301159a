"""Volumes in label maps of NRRD and NIfTI, in files that pynrrd 1.1.3 and nibabel 5.4.2 wrote."""

import base64
import gzip
import re
import struct
from pathlib import Path

import pytest

from mammometry.base.errors import SessionError
from mammometry.io.label_maps.read import is_label_map, segment_cc

VOXEL_MM3 = 0.9 * 1.1 * 2.5
"""Of all files: their axes are turned, and their edges 0.9, 1.1 and 2.5 mm."""
FIRST, SECOND = 35 * VOXEL_MM3 / 1000, 12 * VOXEL_MM3 / 1000
"""Volumes of labels 1 and 2, cc."""
_FILES = {
    "one.nii.gz": (
        "H4sIAAAAAAAE/4thZCAKMDOwM7AxsDIwQiGqJiYGDrBAg31aWpr92TM99gwMCg4MDA1AGhlvcIbwwYqZUM0YCB4TA4tDi21JYPK+"
        "QltHoFs/HGRgWOAIxA57y6P3rWpq2y/P9WAfSHzCUz/7orlq+0rmtOwHqXlcv8qOR2rCvvSnfEB/LgBiVJCnbYgqQDyPERwljNgo"
        "VEMQSpiAYQnkQSlUVSAe8SoRekGGAQGUQogDAKQ+1EUyAgAA"
    ),
    "version-2.nii": (
        "H4sIAAAAAAACA5NhYmDI0zZi4OWS4mJhEGBgZoAAdijNBqVZoTQjARo/+GB/Bgze2M+eCQIf7SHiLA4weVy0AhOqOQxDAICcLMfM"
        "2MrQscG+5DV3g17Wmf2btPUU1qm/gLrf7gCENoH6X8Rhsqfn9O95p/d/E+u0Db3wYf/DJWnvnBnv7IepT9ly+efGOy/t67jtjNdd"
        "PrJ/V8/ahr7JH/bDzPkavzzxj/9V+/zAiHpH5kv7S7ZbXFxzhxFuPsxdgwswIqUfRqJ5hExE18cE9Tk23kCZiT3dMOHkYQMAFpMB"
        "FsQDAAA="
    ),
    "big-endian.nii": (
        "H4sIAAAAAAACA2NgYIxhIAYwM7AzsDGwMjBCISoQYFBgYLBvAOK0tDT7njNnHWB8JOy8AUJDARPDwAMm2xYHln3JgSX2jraFBz8w"
        "MDguYGBwAOJ90eV797c1rdr3gEseJG7v93TCPrW5Rftb5pSA1Nitqn+8b4IUjwPf03SQenSQp23IMNwALB5xiVNTjlI3ErLPgQGC"
        "SZUbae4kFqC7hVg5YgEAdzWl06gEAAA="
    ),
    "layers.seg.nrrd": (
        "H4sIAAAAAAACA1VQvY7TQBDOHSCQW0oKVkJCF5E4u7P/FtcEJBpIcZyokDjHniQr7LWxN0K5CtFQUNNcRcFj8Ag8CI/BOge6sM3O"
        "fn8zO4uzs+eUUpk8Iucb15NFfJOVq5B8zHuyRo9dHrAkyx1pd77ryihsPAEKasrYFCxhPKM0A33y4tX5OI30s6ZuKwx4kLVqujoP"
        "pG+xcCtX5MHFjDxkUb0Joc1ms4BYp32z7QqM4jWmHsNs6De79qabUFdJ2LWYka3zwSSlq9H3MSgjIunbvIhMhaswbZs+YOeabtpv"
        "232R9O4S+4wA0UQRea0mpeuwGCaJjG88kpMpTYEJDtwKo7mKleATmhpqmKWcC1DSWsNMxDjnlCorrNZgtBUwjnaWUkmNAimYlEIC"
        "5ZMYyRRoaq2WoIALJuwAgmEiNgEGWiqprRzv2wuuZUzkDMAOY+jJEMoVBSE1WEulMmoCKfDoY0N3o4y0ME7eO1/Gj1SuD6Rs6tz5"
        "/68EfdGUzq8zsr50bfIa13F/gb5b5DVmp8PmyLLDvA831Mt8idWbvNpGATuEd9hlp/Qfwv5mdG69CTfgoRsO4b2bJcnDr/dGwzm+"
        "VVx8v3txe16qD0/nj5e/i+P5259HcP/Jp6vP377cGY1+7R5c/Tgajf4AIXlOA64CAAA="
    ),
    "raw.nrrd": (
        "H4sIAAAAAAACA8WQzY7UMAzHgWOfIhKXrdR2Eue7V5A4sYfVvkC39cxEtGmVZLUanh53F6QFDYIT2If479g/J769u/vIOdfVe3Z/"
        "DpndkmbHMCN7GjI7YcQ0FJzYw4Vtl5jSRIVrZMDBtEK04JmQPec92JtPn+/rjq4/rMs2Y8FXrOOalqGwvOEYjmEcSiDGUHqqPpey"
        "9YdDQVy6vD6mEan4hF3EctjnHV56u3NZ5qpcNuxZiEWYagoLxkygnskqb8NINzMeS7utuWAKa2rz4/YcVDl8xdwzywzTL7VsCgnH"
        "/R2Uv2l5B0JJkF45Kw1FSja8c9wJz6VUYLT3TjjKSSk5N155a8FZr6CmdtFxzZ0BrYTWSgOXDSGFAcu9txoMSCWU35PghKIhIMBq"
        "o63X9fN4Ja0mohQAfn+GbXaoNByUtuA918aZBjqQ1Cf26c447aGuvoQ40R+mdRlC/PmoME5hoAXNoZQZSY7rFOKpZ2l4+r6HNYVT"
        "iPsOJG+AN7quqjf/xN6Sv47/Tv2J+GvfO/Lfqf/FvGY/KNfUNfsG2yhbprkDAAA="
    ),
}
"""Name → content in base64, packed by gzip unless the file is."""


def content(name: str) -> bytes:
    stored = base64.b64decode(_FILES[name])
    return stored if name.endswith(".gz") else gzip.decompress(stored)


def written(folder: Path, name: str, data: bytes) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def changed_nifti(start: int, values: bytes) -> bytes:
    data = bytearray(gzip.decompress(content("one.nii.gz")))
    data[start : start + len(values)] = values
    return bytes(data)


def changed_nrrd(pattern: bytes, replacement: bytes) -> bytes:
    return re.sub(pattern, replacement, content("raw.nrrd"), count=1)


@pytest.mark.requirement("R-TRUTH-2")
@pytest.mark.parametrize("name", _FILES)
def test_voxels_times_the_determinant(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, name, content(name))
    assert is_label_map(path)
    assert segment_cc(path, "1") == pytest.approx(FIRST, rel=1e-6)
    assert segment_cc(path, "2") == pytest.approx(SECOND, rel=1e-6)
    for segment in ("", "3", "left"):
        with pytest.raises(SessionError):
            segment_cc(path, segment)


def test_byte_order_of_nrrd(tmp_path: Path) -> None:
    header, _, voxels = content("raw.nrrd").partition(b"\n\n")
    swapped = b"".join(voxels[place : place + 2][::-1] for place in range(0, len(voxels), 2))
    data = header.replace(b"endian: little", b"endian: big") + b"\n\n" + swapped
    assert segment_cc(written(tmp_path, "big.nrrd", data), "2") == pytest.approx(SECOND)


def test_segments_of_slicer_have_names(tmp_path: Path) -> None:
    path = written(tmp_path, "layers.seg.nrrd", content("layers.seg.nrrd"))
    assert segment_cc(path, "left breast") == pytest.approx(FIRST)
    assert segment_cc(path, "right") == pytest.approx(SECOND)


def test_the_only_label_needs_no_number(tmp_path: Path) -> None:
    data = changed_nifti(352, bytes(value if value == 1 else 0 for value in changed_nifti(0, b"")[352:]))
    assert segment_cc(written(tmp_path, "one.nii", data)) == pytest.approx(FIRST, rel=1e-6)
    empty = written(tmp_path, "empty.nii", changed_nifti(352, bytes(7 * 6 * 5)))
    for segment in ("", "1"):
        with pytest.raises(SessionError):
            segment_cc(empty, segment)


@pytest.mark.parametrize(("unit", "code", "mm"), [("m", 1, 1000.0), ("mm", 2, 1.0), ("µm", 3, 0.001)])
def test_stated_units(unit: str, code: int, mm: float, tmp_path: Path) -> None:
    scale = struct.pack("<3f", *(edge / mm for edge in (0.9, 1.1, 2.5)))
    data = bytearray(changed_nifti(80, scale))
    data[123], data[254:256] = code + 8, b"\0\0"  # seconds as the unit of time; no sform
    path = written(tmp_path, "one.nii", bytes(data))
    assert segment_cc(path, "1", "ft") == pytest.approx(FIRST, rel=1e-5)
    stated = f'\\nspace units: "{unit}" "{unit}" "{unit}"\\nkinds:'.encode()
    if unit == "mm":
        path = written(tmp_path, "stated.nrrd", changed_nrrd(rb"\nkinds:", stated))
        assert segment_cc(path, "1", "ft") == pytest.approx(FIRST)


def test_a_unit_that_is_not_stated_is_asked_for(tmp_path: Path) -> None:
    nifti = written(tmp_path, "one.nii", changed_nifti(123, b"\0"))
    nrrd = written(tmp_path, "one.nrrd", changed_nrrd(rb"space: left-posterior-superior", b"space dimension: 3"))
    for path in (nifti, nrrd):
        assert segment_cc(path, "1", "mm") == pytest.approx(FIRST, rel=1e-6)
        assert segment_cc(path, "1", "cm") == pytest.approx(1000 * FIRST, rel=1e-6)
        for units in (None, "", "parsec"):
            with pytest.raises(SessionError):
                segment_cc(path, "1", units)


def test_labels_may_be_stored_with_a_slope(tmp_path: Path) -> None:
    path = written(tmp_path, "one.nii", changed_nifti(112, struct.pack("<2f", 2.0, 3.0)))
    assert segment_cc(path, "5") == pytest.approx(FIRST, rel=1e-6)
    assert segment_cc(path, "7") == pytest.approx(SECOND, rel=1e-6)
    thirds = written(tmp_path, "thirds.nii", changed_nifti(112, struct.pack("<2f", 0.3, 0.0)))
    with pytest.raises(SessionError):  # a map of probabilities
        segment_cc(thirds, "1")


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(content("one.nii.gz")[:120], id="truncated gzip"),
        pytest.param(content("one.nii.gz")[:60] + bytes(20) + content("one.nii.gz")[80:], id="damaged gzip"),
        pytest.param(changed_nifti(0, b"")[:500], id="truncated"),
        pytest.param(b"", id="empty"),
        pytest.param(b"no label map", id="text"),
        pytest.param(changed_nifti(344, b"ni1\0"), id="voxels in another file"),
        pytest.param(changed_nifti(70, struct.pack("<h", 128)), id="colours"),
        pytest.param(changed_nifti(40, struct.pack("<5h", 4, 7, 6, 5, 2)), id="several times"),
        pytest.param(changed_nifti(40, struct.pack("<4h", 3, 7, 6, -5)), id="negative size"),
        pytest.param(changed_nifti(42, struct.pack("<3h", 32000, 32000, 32000)), id="too large"),
        pytest.param(changed_nifti(80, struct.pack("<3f", 0.9, 1.1, 2.6)), id="sform and sizes disagree"),
        pytest.param(changed_nifti(108, struct.pack("<f", float("nan"))), id="no place of the voxels"),
        pytest.param(changed_nifti(280, struct.pack("<12f", *[float("nan")] * 12)), id="no orientation"),
        pytest.param(changed_nifti(123, b"\1"), id="a voxel of 2.5 m³"),
    ],
)
def test_other_nifti_files_are_refused(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(SessionError):
        segment_cc(written(tmp_path, "wrong.nii", data), "1")


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(content("raw.nrrd")[:-1], id="truncated"),
        pytest.param(content("layers.seg.nrrd")[:-20], id="truncated gzip"),
        pytest.param(b"NRRD0005\ntype: uint8\n", id="no end of the header"),
        pytest.param(b"", id="empty"),
        pytest.param(changed_nrrd(rb"type: int16", b"type: block"), id="blocks"),
        pytest.param(changed_nrrd(rb"encoding: raw", b"encoding: hex"), id="another encoding"),
        pytest.param(changed_nrrd(rb"encoding: raw", b"encoding: raw\ndata file: LIST"), id="voxels in other files"),
        pytest.param(changed_nrrd(rb"endian: little\n", b""), id="no byte order"),
        pytest.param(changed_nrrd(rb"sizes: 7 6 5", b"sizes: 7 6"), id="two sizes"),
        pytest.param(changed_nrrd(rb"sizes: 7 6 5", b"sizes: 7 6 0"), id="no slices"),
        pytest.param(changed_nrrd(rb"sizes: 7 6 5", b"sizes: 99999 99999 99999"), id="too large"),
        pytest.param(changed_nrrd(rb"space directions: \([^)]*\)", b"space directions: (0,0,0)"), id="flat voxels"),
        pytest.param(changed_nrrd(rb"space directions: .*\n", b""), id="no size of a voxel"),
        pytest.param(changed_nrrd(rb"\nkinds:", b'\nspace units: "mm" "cm" "mm"\nkinds:'), id="mixed units"),
    ],
)
def test_other_nrrd_files_are_refused(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(SessionError):
        segment_cc(written(tmp_path, "wrong.nrrd", data), "1")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    for name in ("absent.nrrd", "absent.nii.gz"):
        with pytest.raises(SessionError):
            segment_cc(tmp_path / name, "1")
