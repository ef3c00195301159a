"""A report's content as one file, from which the report is rendered again."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from mammometry.base.errors import StorageError
from mammometry.report.content import Picture, ReportContent

if TYPE_CHECKING:
    from pydantic import TypeAdapter

CONTENT = "content.zip"
_WORDS, _SCENE = "content.json", "scene.json"
_LARGEST = 256 << 20  # bytes of all members; ours have a few MB
_ALWAYS = (1980, 1, 1, 0, 0, 0)  # time of every member: the same content gives the same bytes


def packed(content: ReportContent) -> bytes:
    """The content as a ZIP: words and captions as JSON, the viewer's scene, pictures as they are shown."""
    bare = {
        stage: {name: replace(picture, webp=b"", jpeg=b"") for name, picture in drawn.items()}
        for stage, drawn in content.pictures.items()
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:

        def add(name: str, data: bytes) -> None:
            archive.writestr(zipfile.ZipInfo(name, _ALWAYS), data)

        add(_WORDS, _adapter().dump_json(replace(content, pictures=bare, scene="")))
        add(_SCENE, content.scene.encode())
        for name, data in _files(content.pictures):
            add(name, data)
    return buffer.getvalue()


def unpacked(data: bytes) -> ReportContent:
    """The content of such a ZIP.

    Raises:
        StorageError: it is not as it was written.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(member.file_size for member in archive.infolist()) > _LARGEST:
                raise ValueError(f"more than {_LARGEST >> 20} MB")
            members = set(archive.namelist())
            content = _adapter().validate_json(archive.read(_WORDS))
            pictures = {
                stage: {
                    name: replace(
                        picture,
                        webp=archive.read(f"{stage}/{name}.webp"),
                        jpeg=archive.read(f"{stage}/{name}.jpg") if f"{stage}/{name}.jpg" in members else b"",
                    )
                    for name, picture in drawn.items()
                }
                for stage, drawn in content.pictures.items()
            }
            scene = archive.read(_SCENE).decode().replace("<", "\\u003c")  # safe inside a page, whoever wrote it
    except (OSError, ValueError, LookupError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise StorageError(
            CONTENT,
            found=f"a result that cannot be read back ({error})",
            expected="the file as it was written",
            remedy="Run the command again: it will be made again",
        ) from None
    return replace(content, pictures=pictures, scene=scene)


def _files(pictures: Mapping[str, Mapping[str, Picture]]) -> Iterator[tuple[str, bytes]]:
    for stage, drawn in pictures.items():
        for name, picture in drawn.items():
            yield f"{stage}/{name}.webp", picture.webp
            if picture.jpeg:
                yield f"{stage}/{name}.jpg", picture.jpeg


def _adapter() -> TypeAdapter[ReportContent]:
    from pydantic import TypeAdapter

    return TypeAdapter(ReportContent)
