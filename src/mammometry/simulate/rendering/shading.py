"""Compiled inner loops of the renderer: colour and light on surfaces.

Colour is a function of the position on the surface. All sizes here are made up; no measurement uses them. Plain NumPy
versions are in tests/unit/simulate/test_kernels.py and test_shading.py. The kernels release the GIL, so that images are
rendered by as many threads as there are cores.
"""

import math

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array
from mammometry.simulate.rendering.kernels import GOLDEN, U16, mixed

OCTAVES = 9
"""Octaves of the mottling: wavelengths from `COARSEST_MM` halved down to 0.16 mm."""
COARSEST_MM = 40.0
CHROMA_OCTAVES = 5
COARSE_FOOTPRINTS = 6.0
"""Pixels over which coarser patterns are treated as linear, so that their mean is their value at the centre."""
FACET_MM = 0.8
"""Size of the facets that make the sheen rough."""
_DARK = 1e-6  # share of the sheen's peak below which it is not computed

_PRIME_X = np.uint64(0x8DA6B343)
_PRIME_Y = np.uint64(0xD8163841)
_PRIME_Z = np.uint64(0xCB1AB31F)


@kernel
def _gradient_noise(x: float, y: float, z: float, seed: np.uint64) -> float:
    """Smooth noise with unit wavelength and about unit standard deviation, by position and seed alone."""
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    ix, iy, iz = np.int64(fx), np.int64(fy), np.int64(fz)
    x -= fx
    y -= fy
    z -= fz
    wx = x * x * x * (x * (x * 6.0 - 15.0) + 10.0)
    wy = y * y * y * (y * (y * 6.0 - 15.0) + 10.0)
    wz = z * z * z * (z * (z * 6.0 - 15.0) + 10.0)
    total = 0.0
    for corner in range(8):
        a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
        bits = mixed(np.uint64(ix + a) * _PRIME_X ^ np.uint64(iy + b) * _PRIME_Y ^ np.uint64(iz + c) * _PRIME_Z ^ seed)
        gx = np.float64(bits & U16) - 32767.5
        gy = np.float64((bits >> np.uint64(16)) & U16) - 32767.5
        gz = np.float64((bits >> np.uint64(32)) & U16) - 32767.5
        weight = (wx if a else 1.0 - wx) * (wy if b else 1.0 - wy) * (wz if c else 1.0 - wz)
        total += weight * (gx * (x - a) + gy * (y - b) + gz * (z - c))
    return total * (3.9 / 32767.5)


@kernel
def mottling(
    x: float, y: float, z: float, footprint: float, first: int, octaves: int, weights: Array, seed: np.uint64
) -> float:
    """Sum of octaves of noise at a point, mm, from `first` to below `octaves`.

    An octave fades as its wavelength approaches the pixel's footprint.
    """
    total = 0.0
    wavelength = COARSEST_MM
    for k in range(octaves):
        fade = (wavelength / footprint - 0.8) / 0.8
        if fade <= 0.0:
            break
        # Each octave has a rotated and shifted lattice, so that no lattice is visible.
        a, b, c = 0.8 * x + 0.6 * y, 0.8 * y - 0.6 * x, z
        x, y, z = a, 0.8 * b + 0.6 * c, 0.8 * c - 0.6 * b
        if k >= first:
            noise = _gradient_noise(
                x / wavelength + 0.37 * k, y / wavelength, z / wavelength, mixed(seed + np.uint64(k + 1) * GOLDEN)
            )
            total += weights[k] * min(fade, 1.0) * noise
        wavelength *= 0.5
    return total


@kernel
def spots(x: float, y: float, z: float, cell: float, least: float, most: float, share: float, seed: np.uint64) -> float:
    """Depth of a point in one of the balls that fill space: 1 inside, falling to 0 at the edge.

    A share `share` of the cells has a ball of radius `least` … `most`, completely within its cell.
    """
    fx, fy, fz = math.floor(x / cell), math.floor(y / cell), math.floor(z / cell)
    bits = mixed(
        np.uint64(np.int64(fx)) * _PRIME_X
        ^ np.uint64(np.int64(fy)) * _PRIME_Y
        ^ np.uint64(np.int64(fz)) * _PRIME_Z
        ^ seed
    )
    size = mixed(bits)
    if np.float64(size & U16) >= share * 65535.0:
        return 0.0
    radius = least + (most - least) * (np.float64((size >> np.uint64(16)) & U16) / 65535.0)
    room = cell - 2.0 * radius
    dx = x - fx * cell - radius - room * (np.float64(bits & U16) / 65535.0)
    dy = y - fy * cell - radius - room * (np.float64((bits >> np.uint64(16)) & U16) / 65535.0)
    dz = z - fz * cell - radius - room * (np.float64((bits >> np.uint64(32)) & U16) / 65535.0)
    inside = 1.0 - math.sqrt(dx * dx + dy * dy + dz * dz) / radius
    if inside <= 0.0:
        return 0.0
    soft = min(1.0, 2.5 * inside)
    return soft * soft * (3.0 - 2.0 * soft)


@kernel
def veins(x: float, y: float, z: float, seed: np.uint64) -> float:
    """Strength of a vein at a point, mm, 0…1: soft lines where noise is zero, only in some places."""
    wander = _gradient_noise(x / 17.0, y / 17.0, z / 17.0, mixed(seed + GOLDEN))
    line = _gradient_noise(x / 48.0 + 0.25 * wander, y / 48.0, z / 48.0, seed) / 0.11
    if abs(line) > 3.0:
        return 0.0
    place = _gradient_noise(x / 70.0, y / 70.0, z / 70.0, mixed(seed + np.uint64(2) * GOLDEN))
    return math.exp(-line * line) / (1.0 + math.exp(-4.0 * place))


@kernel
def paint(
    x: float,
    y: float,
    z: float,
    areola: float,
    footprint: float,
    first: int,
    coarse: float,
    coarse_tint: float,
    colours: Array,
    spectrum: Array,
    marks: Array,
    seed: np.uint64,
    chroma_seed: np.uint64,
) -> tuple[float, float, float]:
    """Reflectance of the skin at a point, mm: red, green, blue. For the arguments see `shade`.

    `coarse` and `coarse_tint` are the octaves before `first` of the mottling of lightness and colour.
    """
    lightness = math.exp(coarse + mottling(x, y, z, footprint, first, OCTAVES, spectrum[0], seed))
    tint = math.exp(coarse_tint + mottling(x, y, z, footprint, first, CHROMA_OCTAVES, spectrum[1], chroma_seed))
    red = (colours[0, 0] + areola * (colours[1, 0] - colours[0, 0])) * lightness * tint
    green = (colours[0, 1] + areola * (colours[1, 1] - colours[0, 1])) * lightness
    blue = (colours[0, 2] + areola * (colours[1, 2] - colours[0, 2])) * lightness / tint
    if marks[2] > 0.0:
        depth = marks[2] * veins(x, y, z, mixed(seed + np.uint64(106))) * (1.0 - areola)
        red *= math.exp(-depth)
        green *= math.exp(-0.45 * depth)
        blue *= math.exp(-0.12 * depth)
    if marks[0] > 0.0:
        fade = min(1.0, 0.25 / footprint)  # if narrower than a pixel, only a share of the pixel is dark
        pore = spots(x, y, z, 0.75, 0.12, 0.3, 1.0, mixed(seed + np.uint64(107)))
        shadow = 1.0 - marks[0] * fade * pore
        red, green, blue = red * shadow, green * shadow, blue * shadow
    if marks[1] > 0.0:
        # An irregular outline, because moles are not round.
        wobble = 0.5 * _gradient_noise(x / 2.5, y / 2.5, z / 2.5, chroma_seed)
        mole = spots(x + wobble, y - wobble, z + 0.6 * wobble, 20.0, 0.6, 2.6, marks[1], mixed(seed + np.uint64(108)))
        red *= 1.0 - 0.62 * mole
        green *= 1.0 - 0.74 * mole
        blue *= 1.0 - 0.76 * mole
    return red, green, blue


@kernel
def paint_at(
    points: Array, areola: Array, footprint: float, colours: Array, spectrum: Array, marks: Array, seed: np.uint64
) -> Array:
    """Reflectance (n, 3) of the skin at points (n, 3), mm, with shares of areola (n,). See `shade`."""
    painted = np.empty((points.shape[0], 3))
    chroma_seed = mixed(seed + np.uint64(101))
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        colour = paint(x, y, z, areola[i], footprint, 0, 0.0, 0.0, colours, spectrum, marks, seed, chroma_seed)
        painted[i, 0], painted[i, 1], painted[i, 2] = colour
    return painted


@kernel
def _light(
    x: float,
    y: float,
    z: float,
    px: float,
    py: float,
    pz: float,
    values: Array,
    bare: bool,
    centre: Array,
    lights: Array,
    sheen: Array,
    wrap: float,
    ambient: float,
    seed: np.uint64,
) -> tuple[float, float]:
    """Diffuse irradiance and specular light at a point, mm. See `shade`.

    `values` are the attributes there. `px`, `py`, `pz` is the position to which the skin's colour and facets belong.
    """
    exponent, patches, roughness = sheen[1], sheen[2], sheen[3]
    nx, ny, nz = values[0], values[1], values[2]
    length = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
    nx, ny, nz = nx * length, ny * length, nz * length
    ex, ey, ez = centre[0] - x, centre[1] - y, centre[2] - z
    length = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
    ex, ey, ez = ex * length, ey * length, ez * length
    gx, gy, gz, sheen_here = nx, ny, nz, sheen[0]
    if bare and sheen_here > 0.0 and roughness > 0.0:
        a, b, c = px / FACET_MM, py / FACET_MM, pz / FACET_MM
        gx += roughness * _gradient_noise(a, b, c, mixed(seed + np.uint64(102)))
        gy += roughness * _gradient_noise(a, b, c, mixed(seed + np.uint64(103)))
        gz += roughness * _gradient_noise(a, b, c, mixed(seed + np.uint64(104)))
        length = 1.0 / math.sqrt(gx * gx + gy * gy + gz * gz)
        gx, gy, gz = gx * length, gy * length, gz * length
    if bare and sheen_here > 0.0 and patches > 0.0:
        patch = _gradient_noise(px / 11.0, py / 11.0, pz / 11.0, mixed(seed + np.uint64(105)))
        sheen_here *= max(0.0, 1.0 + patches * patch)
    # Specular light below a millionth of its peak is skipped, because the power is expensive.
    least = math.exp(math.log(_DARK) / exponent)

    diffuse, glint = ambient * values[4], 0.0
    for k in range(lights.shape[0]):
        seen = values[8 + k]
        if seen <= 0.0:
            continue
        lx, ly, lz = lights[k, 0] - x, lights[k, 1] - y, lights[k, 2] - z
        r2 = lx * lx + ly * ly + lz * lz
        r = math.sqrt(r2)
        lx, ly, lz = lx / r, ly / r, lz / r
        cosine = nx * lx + ny * ly + nz * lz
        strength = seen * lights[k, 3] / r2
        diffuse += strength * max(0.0, (cosine + wrap) / (1.0 + wrap))
        if cosine > 0.0 and sheen_here > 0.0:
            hx, hy, hz = lx + ex, ly + ey, lz + ez
            half = (gx * hx + gy * hy + gz * hz) / math.sqrt(hx * hx + hy * hy + hz * hz)
            if half > least:
                glint += strength * cosine * sheen_here * half**exponent
    return diffuse, glint * (exponent + 8.0) / 8.0


@kernel
def shade(
    samples: int,
    shared: int,
    primitive: Array,
    second: Array,
    third: Array,
    faces: Array,
    vertices: Array,
    painted: Array,
    attributes: Array,
    material: Array,
    centre: Array,
    focal_px: float,
    lights: Array,
    colours: Array,
    spectrum: Array,
    sheen: Array,
    marks: Array,
    wrap: float,
    ambient: float,
    plain_contrast: float,
    seed: np.uint64,
    background: float,
    image: Array,
) -> None:
    """Add the light of n samples to `image` (n / samples, 3). White in full light is 1.

    Args:
        samples: number for each pixel, one after the other.
        shared: number of successive samples of one pixel on a smooth piece, or 1. They share light and the coarse part
            of the mottling, both computed at their centre.
        primitive: (n / shared,) the face hit, −1 for none.
        second: (n,) barycentric weight of the face's second vertex.
        third: (n,) barycentric weight of its third vertex.
        faces: (m, 3) vertex indices.
        vertices: (v, 3) mm, scene frame.
        painted: (v, 3) mm, positions to which the colours belong: others if the subject has moved since.
        attributes: (v, 8 + lights) or (v, 11 + lights): normal xyz, areola 0…1, ambient 0…1, light below the surface
            (RGB), then the visible share of each light, then factors of the skin's colour (RGB). Everything but skin
            has no areola: there the number reduces the mottling `plain_contrast`.
        material: (m,) 0 is skin, k row 1 + k of `colours`.
        centre: the camera's perspective centre, scene frame.
        focal_px: the camera's focal length.
        lights: (n, 4) position, mm, and irradiance × mm² at distance 1.
        colours: (2 + k, 3) linear reflectance of the skin, of the areola, and of everything else.
        spectrum: (2, OCTAVES) weights of the mottling: lightness, colour.
        sheen: specular reflectance, its exponent, its patches, roughness.
        marks: strength of pores, share of cells with a mole, strength of veins.
        wrap: softness of grazing light.
        ambient: light of the surroundings.
        plain_contrast: mottling of everything but skin.
        seed: seed of the mottling.
        background: radiance where nothing is hit, added everywhere.
        image: float32 (pixels, 3), added to.
    """
    chroma_seed = mixed(seed + np.uint64(101))
    weight, group_weight = 1.0 / samples, shared / samples
    point, place, values = np.empty(3), np.empty(3), np.empty(attributes.shape[1])
    tint = 8 + lights.shape[0]
    tinted = attributes.shape[1] >= tint + 3
    for group in range(primitive.shape[0]):
        start, face = group * shared, primitive[group]
        pixel = start // samples
        if face < 0:
            for channel in range(3):
                image[pixel, channel] += group_weight * background
            continue
        b1, b2 = 0.0, 0.0
        for i in range(start, start + shared):
            b1 += second[i]
            b2 += third[i]
        b1, b2 = b1 / shared, b2 / shared
        v0, v1, v2 = faces[face, 0], faces[face, 1], faces[face, 2]
        for axis in range(3):
            point[axis] = vertices[v0, axis] * (1.0 - b1 - b2) + vertices[v1, axis] * b1 + vertices[v2, axis] * b2
            place[axis] = painted[v0, axis] * (1.0 - b1 - b2) + painted[v1, axis] * b1 + painted[v2, axis] * b2
        for column in range(values.shape[0]):
            a0, a1, a2 = attributes[v0, column], attributes[v1, column], attributes[v2, column]
            values[column] = a0 * (1.0 - b1 - b2) + a1 * b1 + a2 * b2
        x, y, z = point[0], point[1], point[2]
        px, py, pz = place[0], place[1], place[2]
        footprint = math.sqrt((centre[0] - x) ** 2 + (centre[1] - y) ** 2 + (centre[2] - z) ** 2) / focal_px
        bare = material[face] == 0
        diffuse, glint = _light(x, y, z, px, py, pz, values, bare, centre, lights, sheen, wrap, ambient, seed)
        if not bare:
            cloth = plain_contrast * (1.0 - values[3])
            shine = diffuse * math.exp(cloth * _gradient_noise(px / 5.0, py / 5.0, pz / 5.0, seed))
            for channel in range(3):
                image[pixel, channel] += group_weight * (colours[1 + material[face], channel] * shine + background)
            continue
        areola = values[3]
        first, coarse, coarse_tint = 0, 0.0, 0.0
        if shared > 1:
            wavelength = COARSEST_MM
            while first < OCTAVES and wavelength >= COARSE_FOOTPRINTS * footprint:
                first += 1
                wavelength *= 0.5
            coarse = mottling(px, py, pz, footprint, 0, min(first, OCTAVES), spectrum[0], seed)
            coarse_tint = mottling(px, py, pz, footprint, 0, min(first, CHROMA_OCTAVES), spectrum[1], chroma_seed)
        fine_sheen = shared > 1 and sheen[0] * sheen[3] > 0.0 and COARSE_FOOTPRINTS * footprint > FACET_MM
        for i in range(start, start + shared):
            b1, b2 = np.float64(second[i]), np.float64(third[i])
            px = painted[v0, 0] * (1.0 - b1 - b2) + painted[v1, 0] * b1 + painted[v2, 0] * b2
            py = painted[v0, 1] * (1.0 - b1 - b2) + painted[v1, 1] * b1 + painted[v2, 1] * b2
            pz = painted[v0, 2] * (1.0 - b1 - b2) + painted[v1, 2] * b1 + painted[v2, 2] * b2
            if fine_sheen:
                x = vertices[v0, 0] * (1.0 - b1 - b2) + vertices[v1, 0] * b1 + vertices[v2, 0] * b2
                y = vertices[v0, 1] * (1.0 - b1 - b2) + vertices[v1, 1] * b1 + vertices[v2, 1] * b2
                z = vertices[v0, 2] * (1.0 - b1 - b2) + vertices[v1, 2] * b1 + vertices[v2, 2] * b2
                diffuse, glint = _light(x, y, z, px, py, pz, values, bare, centre, lights, sheen, wrap, ambient, seed)
            red, green, blue = paint(
                px, py, pz, areola, footprint, first, coarse, coarse_tint, colours, spectrum, marks, seed, chroma_seed
            )
            if tinted:
                red, green, blue = red * values[tint], green * values[tint + 1], blue * values[tint + 2]
            for channel in range(3):
                colour = red if channel == 0 else green if channel == 1 else blue
                lit = max(diffuse + values[5 + channel], 0.0)
                image[pixel, channel] += weight * (min(colour, 0.95) * lit + glint + background)
