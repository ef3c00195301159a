"""The viewing mesh: model.glb, model.obj (.mtl, .jpg) and .npz."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.io.results.formats.arrays import read_arrays, write_arrays
from mammometry.io.results.formats.registry import FORMATS, Format

if TYPE_CHECKING:
    from mammometry.surface.atlas import Atlas


def _write(path: Path, model: Atlas) -> None:
    from mammometry.io.models import (
        write_glb,
        write_obj,
    )  # brings compilers, which reading other results need not wait for

    write_arrays(path.with_suffix(".npz"), model)
    write_obj(path.with_suffix(".obj"), model)
    write_glb(path, model)


FORMATS.add("model")(Format(write=_write, read=read_arrays, ending=".glb", read_ending=".npz"))
