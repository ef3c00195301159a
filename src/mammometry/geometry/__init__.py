"""Basic values: arrays, rigid transforms, cameras, meshes. Compiled code has its own modules."""

from mammometry.geometry.arrays import (
    Array,
    Bool,
    Float32,
    Float64,
    Int32,
    Int64,
    Integer,
    Shaped,
    UInt8,
    UInt16,
    bounds,
    read_only,
)  # fmt: skip
from mammometry.geometry.camera import Camera, Rig, StereoPair
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform

__all__ = [
    "Array", "Bool", "Camera", "Float32", "Float64", "Int32", "Int64", "Integer", "Rig", "Shaped", "StereoPair",
    "Transform", "TriangleMesh", "UInt8", "UInt16", "bounds", "read_only",
]  # fmt: skip
