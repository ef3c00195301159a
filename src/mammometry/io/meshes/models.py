"""Textured meshes as GLB and OBJ for any viewer.

Units are metres in GLB, as its standard says, and mm in OBJ.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mammometry.geometry.arrays import Array, Float64, Int32
from mammometry.surface.texture.texture_atlas import Atlas, jpeg_of


def write_glb(path: Path, atlas: Atlas) -> None:
    """Write one binary glTF file, with its picture inside, in metres.

    Raises:
        OSError: the disk refuses.
    """
    import trimesh

    vertices, faces, uv = _unwelded(atlas)
    picture = Image.open(io.BytesIO(jpeg_of(atlas)), formats=("JPEG",))
    visual: Any = trimesh.visual
    material = visual.material.PBRMaterial(baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0)
    mesh = trimesh.Trimesh(
        vertices=vertices / 1000.0, faces=faces, visual=visual.TextureVisuals(uv=uv, material=material), process=False
    )
    exported: Any = mesh.export(file_type="glb")
    path.write_bytes(exported)


def write_obj(path: Path, atlas: Atlas) -> None:
    """Write an OBJ with its material and picture (NAME.mtl, NAME.jpg), mm.

    Raises:
        OSError: the disk refuses.
    """
    path.with_suffix(".jpg").write_bytes(jpeg_of(atlas))
    path.with_suffix(".mtl").write_text(material(f"{path.stem}.jpg"))
    path.write_text(obj_text(atlas, f"{path.stem}.mtl"))


def material(picture: str) -> str:
    """Text of a material file: ``skin`` shows the picture, ``wall`` is grey."""
    return f"newmtl skin\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nmap_Kd {picture}\nnewmtl wall\nKd 0.5 0.5 0.5\nKs 0 0 0\n"


def obj_text(atlas: Atlas, library: str, wall: Int32[Array, "k 3"] | None = None) -> str:
    """Text of an OBJ, mm.

    Args:
        atlas: the covered mesh.
        library: name of its material file.
        wall: further faces on the same vertices, without a picture.
    """
    origin, faces, uv = atlas.unwelded()
    corners = np.stack([origin[faces], faces], axis=2) + 1
    return (
        f"# mm, world frame\nmtllib {library}\nusemtl skin\n"
        + _lines("v %.4f %.4f %.4f\n", atlas.mesh.vertices)
        + _lines("vt %.6f %.6f\n", _upwards(uv))
        + _lines("f %d/%d %d/%d %d/%d\n", corners)
        + ("" if wall is None else "usemtl wall\n" + _lines("f %d %d %d\n", wall + 1))
    )


def _lines(line: str, rows: Array) -> str:
    """Every row as a line of text. All in one go, for there are hundreds of thousands."""
    return line * len(rows) % tuple(rows.ravel().tolist())


def _unwelded(atlas: Atlas) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"], Float64[Array, "n 2"]]:
    """Vertices, faces and texture coordinates, each vertex once a chart.

    Texture coordinates run from (0, 0), lower left, to (1, 1), upper right.
    """
    origin, faces, uv = atlas.unwelded()
    return atlas.mesh.vertices[origin], faces, _upwards(uv)


def _upwards(uv: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
    return np.column_stack([uv[:, 0], 1.0 - uv[:, 1]])
