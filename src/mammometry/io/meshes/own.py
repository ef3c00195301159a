"""Our triangle meshes: PLY (mm, world frame), and textured GLB (metres) and OBJ (mm) for viewers."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mammometry.base.errors import SessionError, StorageError
from mammometry.base.parse import LARGEST, error_text, read_bytes
from mammometry.base.sizes import fitting, subject_extent
from mammometry.geometry import Array, Float64, Int32, TriangleMesh
from mammometry.geometry.mesh_files import obj
from mammometry.geometry.mesh_files.ply import parse_ply

if TYPE_CHECKING:
    from mammometry.surface.texture.texture_atlas import Atlas

_MOST_MIB = 4096  # largest file: a hundred million vertices


def read_ply(path: Path) -> tuple[TriangleMesh, dict[str, Array], tuple[str, ...]]:
    """Read the mesh, further vertex properties and comments of a PLY in mm.

    Raises:
        StorageError: it is not such a file, or is incomplete.
    """
    expected = "a PLY with triangles"
    data = read_bytes(path, path.name, expected, most_mib=_MOST_MIB, refusal=StorageError)
    try:
        ply = parse_ply(data, path.name)
        if "face" not in ply.elements:
            raise ValueError("no faces")
        if not (np.abs(ply.points) <= LARGEST).all():
            raise ValueError("coordinates that are not finite")
        if ply.faces.max(initial=0) > np.iinfo(np.int32).max:
            raise ValueError("faces with missing vertices")
        mesh = TriangleMesh(vertices=ply.points, faces=ply.faces.astype(np.int32))
        return mesh, ply.properties(), ply.comments
    except MemoryError:
        raise
    except Exception as error:  # the parser raises many kinds of exceptions for damaged files
        found = f"a mesh that cannot be read ({error_text(error)})"
        raise StorageError(path.name, found=found, expected=expected, remedy="Export the mesh again") from None


def read_wall(path: Path) -> TriangleMesh:
    """Read a separately measured wall behind a breast, mm.

    Raises:
        SessionError: see `read_ply`; or it is too small or too large for a wall in mm.
    """
    wall = read_ply(path)[0]
    extent = subject_extent(float(np.ptp(wall.vertices, axis=0).max()))
    if not extent.is_possible:
        remedy = f"Export it in millimetres{fitting(extent.mm, [extent])}"
        raise SessionError(path.name, found=f"a wall of which {extent}", expected=extent.expected, remedy=remedy)
    return wall


def write_glb(path: Path, atlas: Atlas) -> None:
    """Write one binary glTF file in metres, which includes its picture.

    Raises:
        OSError: the disk reports an error.
    """
    import trimesh
    from PIL import Image

    from mammometry.surface.texture.texture_atlas import jpeg_of

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
        OSError: the disk reports an error.
    """
    from mammometry.surface.texture.texture_atlas import jpeg_of

    path.with_suffix(".jpg").write_bytes(jpeg_of(atlas))
    path.with_suffix(".mtl").write_text(material(f"{path.stem}.jpg"))
    path.write_text(obj_text(atlas, f"{path.stem}.mtl"))


def material(picture: str) -> str:
    """Text of a material file: ``skin`` shows the picture, ``wall`` is grey."""
    return f"newmtl skin\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nmap_Kd {picture}\nnewmtl wall\nKd 0.5 0.5 0.5\nKs 0 0 0\n"


def obj_text(atlas: Atlas, library: str, wall: Int32[Array, "k 3"] | None = None) -> str:
    """Text of an OBJ, mm.

    Args:
        atlas: the textured mesh.
        library: name of its material file.
        wall: further faces on the same vertices, without a texture.
    """
    origin, faces, uv = atlas.unwelded()
    parts = [
        obj.ObjPart(material="skin", points=atlas.mesh.vertices, faces=origin[faces], uv=_upwards(uv), face_uv=faces),
        *([] if wall is None else [obj.ObjPart(material="wall", faces=wall)]),
    ]
    return "# mm, world frame\n" + obj.obj_text(library, parts)


def _unwelded(atlas: Atlas) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"], Float64[Array, "n 2"]]:
    """Vertices (separate for each chart), faces, and texture coordinates with (0, 0) at the lower left."""
    origin, faces, uv = atlas.unwelded()
    return atlas.mesh.vertices[origin], faces, _upwards(uv)


def _upwards(uv: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
    return np.column_stack([uv[:, 0], 1.0 - uv[:, 1]])
