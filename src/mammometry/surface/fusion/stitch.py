"""Sewing a coarse isosurface to a fine one at their border.

The border runs along cube faces. Both are marching cubes of fields that agree on those faces: there the fine field is
the bilinear interpolation of the coarse one. So each edge of the coarse cubes has its crossing in both meshes. Between
two such crossings, the fine mesh's border follows the coarse triangle's side in several steps. The coarse triangle
takes over those steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry import mesh_kernels
from mammometry.geometry.arrays import Array, Bool, Float64, Int32, Int64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpenMesh:
    """Vertices and faces of a part of a surface. Vertices are in fine cubes from the grid's origin."""

    vertices: Float64[Array, "n 3"]
    faces: Int32[Array, "m 3"]


def stitched(fine: OpenMesh, coarse: OpenMesh, step: int) -> OpenMesh | None:
    """One closed mesh of both parts.

    None where their borders do not correspond one to one. A coarse cube is `step` fine ones wide.
    """
    border_of_fine, _ = _border(fine)
    border_of_coarse, sides = _border(coarse)
    ends = np.unique(border_of_fine)
    ends = ends[_on_coarse_edge(fine.vertices[ends], step)]
    own = np.unique(border_of_coarse)
    order = np.argsort(edge_keys(fine.vertices[ends], step))
    keys, wanted = edge_keys(fine.vertices[ends], step)[order], edge_keys(coarse.vertices[own], step)
    at = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
    if len(keys) != len(wanted) or not np.array_equal(keys[at], wanted):
        return None

    number = np.empty(len(coarse.vertices), dtype=np.int32)
    alone = np.ones(len(coarse.vertices), dtype=bool)
    alone[own] = False
    number[alone] = len(fine.vertices) + np.arange(int(alone.sum()), dtype=np.int32)
    number[own] = ends[order][at]
    faces = number[coarse.faces]
    chains = _chains(border_of_fine, set(ends.tolist()))
    if chains is None or len(chains) != len(border_of_coarse):
        return None

    outlines: dict[int, dict[tuple[int, int], list[int]]] = {}
    for (start, end), side in zip(number[border_of_coarse].tolist(), sides.tolist(), strict=True):
        steps = chains.get((end, start))
        if steps is None:
            return None
        outlines.setdefault(side, {})[start, end] = steps[::-1]
    vertices = np.concatenate([fine.vertices, coarse.vertices[alone]])
    fans, middles = _fans(faces, outlines, vertices)
    plain = np.ones(len(faces), dtype=bool)
    plain[list(outlines)] = False
    return OpenMesh(
        vertices=np.concatenate([vertices, middles]), faces=np.concatenate([fine.faces, faces[plain], fans])
    )


def _border(mesh: OpenMesh) -> tuple[Int64[Array, "e 2"], Int64[Array, " e"]]:
    """Directed sides of faces that no other face shares, with their faces."""
    n = len(mesh.vertices)
    ends = mesh_kernels.open_vertices(n, mesh.faces)
    a, b, c = ends[mesh.faces.T]
    near = np.flatnonzero((a & b) | (b & c) | (c & a))
    edges = mesh.faces[near][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    start, end = edges.T
    lonely = ends[start] & ends[end] & ~np.isin(start * n + end, end * n + start)
    return edges[lonely], near[np.flatnonzero(lonely) // 3]


def _on_coarse_edge(vertices: Float64[Array, "n 3"], step: int) -> Bool[Array, " n"]:
    return np.asarray((vertices % step == 0).sum(axis=1) == 2)


def edge_keys(vertices: Float64[Array, "n 3"], step: int) -> Int64[Array, " n"]:
    """Number of the cube edge that holds each vertex.

    Cubes are `step` wide. One edge has one vertex at most.
    """
    low = np.floor(vertices / step).astype(np.int64)
    axis = np.argmax(vertices % step != 0, axis=1)
    keys: Int64[Array, " n"] = (((low[:, 0] << 20) + low[:, 1] << 20) + low[:, 2]) * 3 + axis
    return keys


def _chains(border: Int64[Array, "e 2"], ends: set[int]) -> dict[tuple[int, int], list[int]] | None:
    """From (first, last) to the border's vertices in between.

    One entry for each walk from one end to the next.
    """
    following: dict[int, int] = {}
    starts = []
    for start, end in border.tolist():
        if start in ends:
            starts.append((start, end))
        elif start in following:
            return None
        else:
            following[start] = end
    chains: dict[tuple[int, int], list[int]] = {}
    used = len(starts)
    for start, vertex in starts:
        between: list[int] = []
        while vertex not in ends:
            if len(between) > len(border) or vertex not in following:
                return None
            between.append(vertex)
            vertex = following[vertex]
        if (start, vertex) in chains:
            return None
        chains[start, vertex] = between
        used += len(between)
    return chains if used == len(border) else None  # a loop without an end would stay open


def _fans(
    faces: Int32[Array, "m 3"], outlines: dict[int, dict[tuple[int, int], list[int]]], vertices: Float64[Array, "n 3"]
) -> tuple[Int32[Array, "k 3"], Float64[Array, "j 3"]]:
    """Replace each face with stepped sides by a fan about its middle. Also gives the middles."""
    fans: list[list[int]] = []
    middles: list[Float64[Array, 3]] = []
    for face, stepped in outlines.items():
        corners = faces[face].tolist()
        outline: list[int] = []
        for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
            outline += [start, *stepped.get((start, end), [])]
        if len(outline) == 3:
            fans.append(outline)
            continue
        middle = len(vertices) + len(middles)
        middles.append(vertices[corners].mean(axis=0))
        fans += [[middle, start, end] for start, end in zip(outline, outline[1:] + outline[:1], strict=True)]
    return np.array(fans, dtype=np.int32).reshape(-1, 3), np.array(middles).reshape(-1, 3)
