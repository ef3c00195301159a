"""The finished surface as binary PLY, mm, world frame.

Each vertex has provenance, sigma_mm, pairs and colour.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.meshes.own_ply import read_ply, write_ply
from mammometry.io.results.formats.registry import FORMATS, Format
from mammometry.job.values import FinishedSurface


def _write(path: Path, value: Any) -> None:
    """Write a bare, repaired or finished mesh.

    What is not one number per vertex goes into a comment as JSON.
    """
    properties: dict[str, np.ndarray[Any, Any]] = {}
    about: dict[str, Any] = {}
    repaired = value.repaired if isinstance(value, FinishedSurface) else value
    mesh = repaired if isinstance(repaired, TriangleMesh) else repaired.mesh
    if repaired is not mesh:
        properties |= {
            "provenance": repaired.provenance, "sigma_mm": repaired.sigma_mm, "pairs": _narrowed(repaired.pair_bits)
        }  # fmt: skip
        about = {
            "pair_names": repaired.pair_names,
            "convergence_mm": repaired.convergence.tolist(),
            "crossings": repaired.crossings,
        }
    if isinstance(value, FinishedSurface):
        colours = zip(("red", "green", "blue"), value.textured.colours.T, strict=True)
        properties |= {name: np.ascontiguousarray(channel) for name, channel in colours}
    comments = ("mm, world frame", *((f"mammometry {json.dumps(about)}",) if about else ()))
    write_ply(path, mesh, properties, comments)


def _narrowed(bits: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Numbers of up to eight pairs in one byte each."""
    return bits.astype(np.uint8) if bits.min(initial=0) >= 0 and bits.max(initial=0) < 1 << 8 else bits


def _read(path: Path) -> Any:
    mesh, properties, comments = read_ply(path)
    if "provenance" not in properties:
        return mesh
    from mammometry.surface.repair.repair import RepairedSurface
    from mammometry.surface.texture.texture import TexturedMesh

    (about,) = (json.loads(line.partition(" ")[2]) for line in comments if line.startswith("mammometry "))
    repaired = RepairedSurface(
        mesh=mesh,
        provenance=properties["provenance"],
        sigma_mm=properties["sigma_mm"],
        pair_bits=properties["pairs"].astype(np.int32, copy=False),
        pair_names=tuple(about["pair_names"]),
        convergence=np.array(about["convergence_mm"], dtype=np.float64),
        crossings=about.get("crossings"),
    )
    if "red" not in properties:
        return repaired
    colours = np.stack([properties[name] for name in ("red", "green", "blue")], axis=1)
    return FinishedSurface(repaired=repaired, textured=TexturedMesh(mesh=mesh, colours=colours))


FORMATS.add("mesh")(Format(write=_write, read=_read, ending=".ply"))
