"""The viewing mesh: model.glb, model.obj (.mtl, .jpg) and .npz."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mammometry.io.results.formats.arrays import read_arrays, write_arrays
from mammometry.io.results.formats.registry import FORMATS, Format

if TYPE_CHECKING:
    from mammometry.surface.texture.texture_atlas import Atlas


def _write(path: Path, model: Atlas) -> None:
    # They bring compilers, which reading other results need not wait for.
    from mammometry.io.meshes.models import write_glb, write_obj
    from mammometry.surface.texture.atlas_jpeg import without_picture

    write_arrays(path.with_suffix(".npz"), without_picture(model))
    write_obj(path.with_suffix(".obj"), model)
    write_glb(path, model)


def _read(path: Path) -> Any:
    from mammometry.surface.texture.atlas_jpeg import with_picture

    return with_picture(read_arrays(path))


FORMATS.add("model")(Format(write=_write, read=_read, ending=".glb", read_ending=".npz"))
