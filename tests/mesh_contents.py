"""Mesh files read in the test's own process: hundreds of them would take a child process each."""

from pathlib import Path

from mammometry.geometry import Array, Float64, Int32, UInt8
from mammometry.geometry.mesh_files.mesh_file import parse_mesh_file


def read_triangles(path: Path) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"], UInt8[Array, "n 3"]]:
    """Points, triangles and colours of a mesh file."""
    content = parse_mesh_file(path)
    return content.points, content.faces, content.colours
