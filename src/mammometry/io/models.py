"""Covered meshes as GLB and OBJ, for any viewer: units are metres in GLB, as its standard says, and mm in OBJ."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mammometry.geometry.arrays import Array, Float64, Int32
from mammometry.surface.atlas import Atlas

_QUALITY = 92


def write_glb(path: Path, atlas: Atlas) -> None:
    """Write one binary glTF file, picture inside; metres.

    Raises:
        OSError: the disk refuses.
    """
    import trimesh

    vertices, faces, uv = _unwelded(atlas)
    picture = Image.open(io.BytesIO(_jpeg(atlas)))
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
    """Write an OBJ with its material and picture beside it (NAME.mtl, NAME.jpg); mm.

    Raises:
        OSError: the disk refuses.
    """
    vertices, faces, uv = _unwelded(atlas)
    path.with_suffix(".jpg").write_bytes(_jpeg(atlas))
    path.with_suffix(".mtl").write_text(f"newmtl skin\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nmap_Kd {path.stem}.jpg\n")
    lines = [f"# mm, world frame\nmtllib {path.stem}.mtl\nusemtl skin"]
    lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices.tolist()]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv.tolist()]
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")


def _unwelded(atlas: Atlas) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"], Float64[Array, "n 2"]]:
    """Vertices, faces, and places in the picture, whose lower left corner is (0, 0), upper right (1, 1)."""
    origin, faces, uv = atlas.unwelded()
    return atlas.mesh.vertices[origin], faces, np.column_stack([uv[:, 0], 1.0 - uv[:, 1]])


def _jpeg(atlas: Atlas) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.asarray(atlas.picture)).save(buffer, "JPEG", quality=_QUALITY)
    return buffer.getvalue()
