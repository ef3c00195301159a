"""Meshes and images of a USDZ, as written by telephones.

No other file is read.
"""

from __future__ import annotations

import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.extras import require
from mammometry.base.parse import error_text, require_file
from mammometry.geometry.arrays import Array, Float64, Int64, UInt8
from mammometry.geometry.mesh_files.in_child import read_in_child
from mammometry.geometry.mesh_files.scene import ANIMATED, GREY, HIDDEN, MIRRORED, SUBDIVIDED, SceneContent, ScenePart

_LAYERS = (".usd", ".usda", ".usdc")
_PICTURES = (".png", ".jpg", ".jpeg")
_NO_SURFACE = ("Points", "BasisCurves", "NurbsCurves", "HermiteCurves")  # no surfaces, so there is nothing to measure


def read_usdz(path: Path, *, shape: bool = True) -> SceneContent:
    """Read the meshes of a USDZ in a child process.

    Args:
        path: path of the file.
        shape: whether to read meshes and images, and not only the unit.

    Raises:
        MissingLibraryError: USD is not installed.
        SessionError: the file cannot be read.
    """
    return read_in_child(parse_usdz, path, shape=shape)


def parse_usdz(path: Path, *, shape: bool = True) -> SceneContent:
    """Read the meshes of a USDZ in this process. A damaged file may crash it or make it hang."""
    require_file(path, str(path), "a USDZ")
    require("usdz", "pxr")
    try:
        read = _opened(path, shape=shape)
    except Exception as error:  # the reader raises many kinds of exceptions for damaged files
        read = f"a file that cannot be read ({error_text(error)})"
    if isinstance(read, str):
        expected = "a USDZ with plain meshes inside"
        raise SessionError(str(path), found=read, expected=expected, remedy="Export it again as plain meshes")
    return read


def _opened(path: Path, *, shape: bool) -> SceneContent | str:
    from pxr import Sdf, Usd, UsdGeom

    with tempfile.TemporaryDirectory(prefix="mammometry-") as unpacked:
        folder = Path(unpacked).resolve()
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if any(member.compress_type != zipfile.ZIP_STORED or member.flag_bits & 1 for member in members):
                return "a compressed ZIP, which is not a USDZ"
            archive.extractall(folder)  # extracts only into the folder
            first = next((folder / m.filename for m in members if Path(m.filename).suffix.lower() in _LAYERS), None)
        if first is None:
            return "a ZIP without a USD file"
        for file in sorted(folder.rglob("*")):
            if file.suffix.lower() in _LAYERS:
                layer = Sdf.Layer.FindOrOpen(str(file))
                for name in layer.GetCompositionAssetDependencies() if layer else ():
                    if not (file.parent / name).resolve().is_relative_to(folder):
                        return "meshes in another file"
        stage = Usd.Stage.Open(str(first))
        stated = stage.HasAuthoredMetadata(UsdGeom.Tokens.metersPerUnit)
        pictures: dict[str, bytes] = {}
        remarks: list[str] = []
        if shape and (unread := _unread(stage)):
            return unread
        return SceneContent(
            parts=tuple(_parts(stage, folder, pictures, remarks)) if shape else (),
            pictures=pictures,
            metres_per_unit=float(UsdGeom.GetStageMetersPerUnit(stage)) if stated else None,
            remarks=tuple(dict.fromkeys(remarks)),
        )


def _is_drawn(prim: Any) -> bool:
    """Whether a geometry is visible, and is neither a proxy nor a guide."""
    from pxr import Usd, UsdGeom

    shown = UsdGeom.Imageable(prim).ComputeVisibility(Usd.TimeCode.EarliestTime()) != UsdGeom.Tokens.invisible
    return shown and UsdGeom.Imageable(prim).ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)


def _is_animated(mesh: Any) -> bool:
    from pxr import UsdGeom

    prim = mesh.GetPrim()
    moves = mesh.GetPointsAttr().ValueMightBeTimeVarying()
    while prim and not moves:
        moves = UsdGeom.Xformable(prim).TransformMightBeTimeVarying() if prim.IsA(UsdGeom.Xformable) else False
        prim = prim.GetParent()
    return bool(moves)


def _unread(stage: Any) -> str | None:
    """Name of the first visible object that is not supported. None if all are supported."""
    from pxr import Usd, UsdGeom, UsdSkel

    now = Usd.TimeCode.EarliestTime()
    moves = [UsdSkel.Animation(prim) for prim in stage.Traverse() if prim.IsA(UsdSkel.Animation)]
    blended = any(np.any(np.array(move.GetBlendShapeWeightsAttr().Get(now) or (), dtype=np.float64)) for move in moves)
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if not prim.IsA(UsdGeom.Boundable) or not _is_drawn(prim):
            continue
        if prim.IsA(UsdGeom.PointInstancer):
            return "meshes instanced by a PointInstancer"
        if prim.IsA(UsdGeom.Gprim) and not prim.IsA(UsdGeom.Mesh) and prim.GetTypeName() not in _NO_SURFACE:
            return f"a {prim.GetTypeName()} in addition to its meshes"
        binding = UsdSkel.BindingAPI(prim)
        if prim.IsA(UsdGeom.Mesh) and binding.GetJointIndicesAttr().HasValue() and binding.GetInheritedSkeleton():
            return "a mesh with a skeleton"
        if prim.IsA(UsdGeom.Mesh) and blended and binding.GetBlendShapeTargetsRel().GetTargets():
            return "a mesh with blend shapes"
    return None


def _parts(stage: Any, folder: Path, pictures: dict[str, bytes], remarks: list[str]) -> list[ScenePart]:
    from pxr import Usd, UsdGeom

    places = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    parts = []
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        mesh = UsdGeom.Mesh(prim)
        if not mesh:
            continue
        if not _is_drawn(prim):
            remarks.append(HIDDEN)
            continue
        now = Usd.TimeCode.EarliestTime()
        if mesh.GetSubdivisionSchemeAttr().HasAuthoredValue() and mesh.GetSubdivisionSchemeAttr().Get() != "none":
            remarks.append(SUBDIVIDED)
        if _is_animated(mesh):
            remarks.append(ANIMATED)
        points = np.array(mesh.GetPointsAttr().Get(now) or (), dtype=np.float64).reshape(-1, 3)
        counts, corners = (
            np.array(attribute.Get(now) or (), dtype=np.int64)
            for attribute in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
        )
        if not len(counts):
            continue
        if counts.min() < 0 or counts.sum() != len(corners) or corners.min() < 0 or corners.max() >= len(points):
            raise ValueError("faces refer to vertices that do not exist")
        place = np.array(places.GetLocalToWorldTransform(prim))
        points = points @ place[:3, :3] + place[3, :3]
        polygon, where = _fans(counts)
        kept = ~np.isin(polygon, np.array(mesh.GetHoleIndicesAttr().Get(now) or (), dtype=np.int64))
        polygon, where = polygon[kept], where[kept]
        mirrored = bool(np.linalg.det(place[:3, :3]) < 0)
        remarks += [MIRRORED] if mirrored else []
        if (mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded) != mirrored:
            where = where[:, ::-1]
        faces = corners[where]
        uv, colours = _corner_values(prim, ("st", "UVMap", "st0"), faces, where), _colours(prim, faces, where)
        pictured = _picture_of_each(prim, len(counts), folder, pictures)[polygon]
        for name in dict.fromkeys(pictured.tolist()):
            own = pictured == name
            covered = uv is not None and bool(name)
            parts.append(
                ScenePart(
                    points=points[faces[own]].reshape(-1, 3),
                    faces=np.arange(3 * own.sum()).reshape(-1, 3),
                    colours=colours[own].reshape(-1, 3),
                    uv=uv[own].reshape(-1, 2) if uv is not None and covered else None,
                    picture=str(name) if covered else None,
                )
            )
    return parts


def _fans(counts: Int64[Array, " k"]) -> tuple[Int64[Array, " m"], Int64[Array, "m 3"]]:
    """Split polygons into fans. Returns each triangle's polygon, and its corners' positions in the file's list."""
    triangles = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    number = np.arange(len(polygon)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    first = (np.cumsum(counts) - counts)[polygon]
    return polygon, np.stack([first, first + number + 1, first + number + 2], axis=1)


def _corner_values(
    prim: Any, names: tuple[str, ...], faces: Int64[Array, "m 3"], where: Int64[Array, "m 3"]
) -> Float64[Array, "m 3 k"] | None:
    """Values at each triangle's corners, from the first of these primvars that exists."""
    from pxr import Usd, UsdGeom

    primvars = UsdGeom.PrimvarsAPI(prim)
    for name in names:
        primvar = primvars.FindPrimvarWithInheritance(name)
        flat = primvar.ComputeFlattened(Usd.TimeCode.EarliestTime()) if primvar.HasValue() else None
        if flat is None:
            continue
        values = np.array(flat, dtype=np.float64)
        kind = primvar.GetInterpolation()
        if kind == UsdGeom.Tokens.faceVarying:
            return values[where]
        if kind in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
            return values[faces]
        if kind == UsdGeom.Tokens.constant:
            return np.broadcast_to(values[0], (*faces.shape, values.shape[1]))
    return None


def _colours(prim: Any, faces: Int64[Array, "m 3"], where: Int64[Array, "m 3"]) -> UInt8[Array, "m 3 3"]:
    values = _corner_values(prim, ("displayColor",), faces, where)
    if values is None:
        return np.full((*faces.shape, 3), GREY, dtype=np.uint8)
    return np.round(255 * np.clip(np.nan_to_num(values), 0, 1)).astype(np.uint8)


def _picture_of_each(prim: Any, count: int, folder: Path, pictures: dict[str, bytes]) -> Array:
    """Name of each polygon's image. Empty if it has none."""
    from pxr import UsdShade

    bound = UsdShade.MaterialBindingAPI(prim)
    names = np.full(count, _picture(bound, folder, pictures), dtype=object)
    for subset in bound.GetMaterialBindSubsets():
        own = np.array(subset.GetIndicesAttr().Get() or (), dtype=np.int64)
        names[own[(own >= 0) & (own < count)]] = _picture(UsdShade.MaterialBindingAPI(subset), folder, pictures)
    return names


def _picture(bound: Any, folder: Path, pictures: dict[str, bytes]) -> str:
    """Name of the image of a material's colour. The image is read into `pictures`. Empty if there is none."""
    from pxr import UsdShade

    material, _ = bound.ComputeBoundMaterial()
    shader = material.ComputeSurfaceSource()[0] if material else None
    colour = shader.GetInput("diffuseColor") if shader else None
    for attribute in colour.GetValueProducingAttributes() if colour else ():
        file = UsdShade.Shader(attribute.GetPrim()).GetInput("file")
        asset = file.Get() if file else None
        path = Path(asset.resolvedPath) if asset and asset.resolvedPath else None
        if path is not None and path.suffix.lower() in _PICTURES and path.resolve().is_relative_to(folder):
            pictures.setdefault(path.name, path.read_bytes())
            return path.name
    return ""
