"""Compiled code that looks points up in photographs.

Photographs are read as they were recorded, so that no copy of them in floating point is made. Plain NumPy twins stand
in tests/unit/surface/test_texture_kernels.py.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Integer
from mammometry.surface.fusion.camera_records import LEAST_DEPTH_MM, in_camera, pixel, view_of

_MM_PER_M = 1000.0  # a weight of 1 straight ahead at a metre


@kernel
def facing(
    vertices: Float64[Array, "n 3"],
    normals: Float64[Array, "n 3"],
    row: Float64[Array, " 24"],
    centre: Float64[Array, " 3"],
    least_cosine: float,
    sharpness: float,
) -> tuple[Float32[Array, " n"], Float64[Array, "n 3"]]:
    """Weight of one photograph at each vertex, and its place there. As if nothing stood between.

    Args:
        vertices: world frame, mm.
        normals: unit, outwards.
        row: the camera, as `view_rows.view_row` packs it.
        centre: its perspective centre, world frame, mm.
        least_cosine: of the incidence, at which a photograph still counts.
        sharpness: power of that cosine in the weight.

    Returns:
        cosine to that power over the squared distance in metres, 0 where the camera does not face the vertex or has it
        beside its picture; column, row and inverse depth in 1/mm, column −1 beside the picture.
    """
    view = view_of(row)
    weights, places = np.zeros(len(vertices), dtype=np.float32), np.empty((len(vertices), 3))
    for n in range(len(vertices)):
        x, y, z = vertices[n, 0], vertices[n, 1], vertices[n, 2]
        xc, yc, zc = in_camera(view, x, y, z)
        places[n, 0], places[n, 1] = pixel(view, xc, yc, zc)
        places[n, 2] = 1.0 / max(zc, LEAST_DEPTH_MM)
        if places[n, 0] < 0.0:
            continue
        dx, dy, dz = centre[0] - x, centre[1] - y, centre[2] - z
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        cosine = (normals[n, 0] * dx + normals[n, 1] * dy + normals[n, 2] * dz) / distance
        if cosine > least_cosine:
            weights[n] = cosine**sharpness * (_MM_PER_M / distance) ** 2
    return weights, places


@kernel
def hidden(
    places: Float64[Array, "n 3"], inverse_depths: Float32[Array, "h w"], clearance_mm: float
) -> Bool[Array, " n"]:
    """Points that the surface hides from the camera.

    At all four pixels around such a point the surface stands before it by more than the clearance. A plane through the
    point never does, however oblique it is: at one of the four it lies behind.

    Args:
        places: column and row in pixels of the depths' picture, inverse depth in 1/mm.
        inverse_depths: of the surface nearest to the camera, 1/mm. −∞ where there is none.
        clearance_mm: what stands less than this before a point hides nothing.
    """
    height, width = inverse_depths.shape
    covered = np.zeros(len(places), dtype=np.bool_)
    for n in range(len(places)):
        column, row = int(np.floor(places[n, 0])), int(np.floor(places[n, 1]))
        if column < 0 or row < 0 or column + 1 >= width or row + 1 >= height:
            continue
        least = min(
            min(inverse_depths[row, column], inverse_depths[row, column + 1]),
            min(inverse_depths[row + 1, column], inverse_depths[row + 1, column + 1]),
        )
        covered[n] = least > 0.0 and 1.0 / places[n, 2] - 1.0 / least > clearance_mm
    return covered


@kernel
def colours_at(pixels: Integer[Array, "h w c"], full_scale: float, uv: Float64[Array, "n 2"]) -> Float32[Array, "n 3"]:
    """Colours at places in a photograph, 0…1, linear between pixels.

    Places beside the picture take its border's. `full_scale` is the level that counts as 1. A grey photograph has one
    channel.
    """
    height, width, channels = pixels.shape
    colours = np.empty((len(uv), 3), dtype=np.float32)
    for n in range(len(uv)):
        u, v = min(max(uv[n, 0], 0.0), width - 1.0), min(max(uv[n, 1], 0.0), height - 1.0)
        column, row = int(u), int(v)
        du, dv = u - column, v - row
        right, below = min(column + 1, width - 1), min(row + 1, height - 1)
        for channel in range(3):
            c = min(channel, channels - 1)
            above = (1.0 - du) * pixels[row, column, c] + du * pixels[row, right, c]
            under = (1.0 - du) * pixels[below, column, c] + du * pixels[below, right, c]
            colours[n, channel] = ((1.0 - dv) * above + dv * under) / full_scale
    return colours
