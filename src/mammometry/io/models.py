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
from mammometry.surface.atlas import Atlas

_QUALITY = 92  # of the texture's JPEG, 1…100: the viewer's file stays small; chosen by eye


def write_glb(path: Path, atlas: Atlas) -> None:
    """Write one binary glTF file, with its picture inside, in metres.

    Raises:
        OSError: the disk refuses.
    """
    import trimesh

    vertices, faces, uv = _unwelded(atlas)
    picture = Image.open(io.BytesIO(_jpeg(atlas)), formats=("JPEG",))
    visual: Any = trimesh.visual
    material = visual.material.PBRMaterial(baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0)
    mesh = trimesh.Trimesh(
        vertices=vertices / 1000.0,
        faces=faces,
        visual=visual.TextureVisuals(uv=uv, material=material),
        process=False,
    )
    exported: Any = mesh.export(file_type="glb")
    path.write_bytes(exported)


def write_obj(path: Path, atlas: Atlas) -> None:
    """Write an OBJ with its material and picture (NAME.mtl, NAME.jpg), mm.

    Raises:
        OSError: the disk refuses.
    """
    vertices, faces, uv = _unwelded(atlas)
    path.with_suffix(".jpg").write_bytes(_jpeg(atlas))
    path.with_suffix(".mtl").write_text(f"newmtl skin\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nmap_Kd {path.stem}.jpg\n")
    path.write_text(
        f"# mm, world frame\nmtllib {path.stem}.mtl\nusemtl skin\n"
        + _lines("v %.4f %.4f %.4f\n", vertices)
        + _lines("vt %.6f %.6f\n", uv)
        + _lines("f %d/%d %d/%d %d/%d\n", (faces + 1).repeat(2, axis=1))
    )


def _lines(line: str, rows: Array) -> str:
    """Every row as a line of text.

    All in one go, for there are hundreds of thousands.
    """
    return line * len(rows) % tuple(rows.ravel().tolist())


def _unwelded(atlas: Atlas) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"], Float64[Array, "n 2"]]:
    """Vertices, faces and texture coordinates, each vertex once a chart.

    Texture coordinates run from (0, 0), lower left, to (1, 1), upper right.
    """
    origin, faces, uv = atlas.unwelded()
    return atlas.mesh.vertices[origin], faces, np.column_stack([uv[:, 0], 1.0 - uv[:, 1]])


def _jpeg(atlas: Atlas) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.asarray(atlas.picture)).save(buffer, "JPEG", quality=_QUALITY)
    return buffer.getvalue()
