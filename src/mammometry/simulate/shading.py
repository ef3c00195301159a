"""Compiled inner loops of the renderer: the paint, a function of the place on the surface, and the light on it.

Nothing but kernels; each has a plain NumPy twin in tests/unit/simulate/test_kernels.py or test_shading.py. They release
the interpreter's lock, so that images are rendered by as many threads as there are cores.
"""

import math

import numpy as np
from numba import njit

from mammometry.geometry.arrays import Array
from mammometry.simulate.kernels import GOLDEN, U16, mixed

OCTAVES = 9
"""Octaves of the mottling: wavelengths from `COARSEST_MM` halved down to 0.16 mm."""
COARSEST_MM = 40.0
CHROMA_OCTAVES = 5

_PRIME_X = np.uint64(0x8DA6B343)
_PRIME_Y = np.uint64(0xD8163841)
_PRIME_Z = np.uint64(0xCB1AB31F)


@njit(cache=True, nogil=True)
def _gradient_noise(x: float, y: float, z: float, seed: np.uint64) -> float:
    """Smooth noise of unit wavelength, about unit standard deviation, the same for the same place and seed."""
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


@njit(cache=True, nogil=True)
def mottling(x: float, y: float, z: float, footprint: float, octaves: int, weights: Array, seed: np.uint64) -> float:
    """Sum of octaves of noise at a point, mm; an octave fades out where its wavelength nears the pixel's footprint."""
    total = 0.0
    wavelength = COARSEST_MM
    for k in range(octaves):
        fade = (wavelength / footprint - 0.8) / 0.8
        if fade <= 0.0:
            break
        # Each octave on its own turned and shifted lattice, so that no lattice shows.
        a, b, c = 0.8 * x + 0.6 * y, 0.8 * y - 0.6 * x, z
        x, y, z = a, 0.8 * b + 0.6 * c, 0.8 * c - 0.6 * b
        noise = _gradient_noise(
            x / wavelength + 0.37 * k, y / wavelength, z / wavelength, mixed(seed + np.uint64(k + 1) * GOLDEN)
        )
        total += weights[k] * min(fade, 1.0) * noise
        wavelength *= 0.5
    return total


@njit(cache=True, nogil=True)
def spots(x: float, y: float, z: float, cell: float, least: float, most: float, share: float, seed: np.uint64) -> float:
    """How deep a point, mm, lies in one of the balls strewn through space: 1 within, falling to 0 at the rim.

    One cell in every `share` of cells has a ball of radius `least` … `most`; it lies wholly within its cell.
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


@njit(cache=True, nogil=True)
def veins(x: float, y: float, z: float, seed: np.uint64) -> float:
    """How strongly a vein shows at a point, mm, 0…1: soft lines where noise is zero, in some places only."""
    wander = _gradient_noise(x / 17.0, y / 17.0, z / 17.0, mixed(seed + GOLDEN))
    line = _gradient_noise(x / 48.0 + 0.25 * wander, y / 48.0, z / 48.0, seed) / 0.11
    if abs(line) > 3.0:
        return 0.0
    place = _gradient_noise(x / 70.0, y / 70.0, z / 70.0, mixed(seed + np.uint64(2) * GOLDEN))
    return math.exp(-line * line) / (1.0 + math.exp(-4.0 * place))


@njit(cache=True, nogil=True)
def paint(
    x: float,
    y: float,
    z: float,
    areola: float,
    footprint: float,
    colours: Array,
    spectrum: Array,
    marks: Array,
    seed: np.uint64,
    chroma_seed: np.uint64,
) -> tuple[float, float, float]:
    """Reflectance of the skin at a point, mm: red, green, blue; see `shade` for the arguments."""
    lightness = math.exp(mottling(x, y, z, footprint, OCTAVES, spectrum[0], seed))
    tint = math.exp(mottling(x, y, z, footprint, CHROMA_OCTAVES, spectrum[1], chroma_seed))
    red = (colours[0, 0] + areola * (colours[1, 0] - colours[0, 0])) * lightness * tint
    green = (colours[0, 1] + areola * (colours[1, 1] - colours[0, 1])) * lightness
    blue = (colours[0, 2] + areola * (colours[1, 2] - colours[0, 2])) * lightness / tint
    if marks[2] > 0.0:
        depth = marks[2] * veins(x, y, z, mixed(seed + np.uint64(106))) * (1.0 - areola)
        red *= math.exp(-depth)
        green *= math.exp(-0.45 * depth)
        blue *= math.exp(-0.12 * depth)
    if marks[0] > 0.0:
        fade = min(1.0, 0.25 / footprint)  # narrower than a pixel: only its share of the pixel is dark
        pore = spots(x, y, z, 0.75, 0.12, 0.3, 1.0, mixed(seed + np.uint64(107)))
        shadow = 1.0 - marks[0] * fade * pore
        red, green, blue = red * shadow, green * shadow, blue * shadow
    if marks[1] > 0.0:
        # A wandering outline: moles are not round.
        wobble = 0.5 * _gradient_noise(x / 2.5, y / 2.5, z / 2.5, chroma_seed)
        mole = spots(x + wobble, y - wobble, z + 0.6 * wobble, 20.0, 0.6, 2.6, marks[1], mixed(seed + np.uint64(108)))
        red *= 1.0 - 0.62 * mole
        green *= 1.0 - 0.74 * mole
        blue *= 1.0 - 0.76 * mole
    return red, green, blue


@njit(cache=True, nogil=True)
def paint_at(
    points: Array,
    areola: Array,
    footprint: float,
    colours: Array,
    spectrum: Array,
    marks: Array,
    seed: np.uint64,
) -> Array:
    """Reflectance (n, 3) of the skin at points (n, 3), mm, with their shares of areola (n,); see `shade`."""
    painted = np.empty((points.shape[0], 3))
    chroma_seed = mixed(seed + np.uint64(101))
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        colour = paint(x, y, z, areola[i], footprint, colours, spectrum, marks, seed, chroma_seed)
        painted[i, 0], painted[i, 1], painted[i, 2] = colour
    return painted


@njit(cache=True, nogil=True)
def shade(
    samples: int,
    primitive: Array,
    second: Array,
    third: Array,
    faces: Array,
    vertices: Array,
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
    """Add the light of n samples to `image` (n / samples, 3), white under full light = 1.

    Args:
        samples: of each pixel, one after the other.
        primitive: (n,) the face hit, −1 for none.
        second: (n,) barycentric weight of the face's second vertex.
        third: (n,) of its third.
        faces: (m, 3) vertex indices.
        vertices: (v, 3) mm, scene frame.
        attributes: (v, 8 + lights): normal xyz, areola 0…1, ambient 0…1, light that travelled below the surface (RGB),
            then which share of each light it sees.
        material: (m,) 0 is skin, k the row 1 + k of `colours`.
        centre: the camera's, scene frame.
        focal_px: the camera's focal length.
        lights: (n, 4) position, mm, and irradiance × mm² at distance 1.
        colours: (2 + k, 3) linear reflectance of the skin, of the areola, and of what is not skin.
        spectrum: (2, OCTAVES) weights of the mottling: lightness, colour.
        sheen: specular reflectance, its exponent, its patches, roughness.
        marks: strength of pores, share of the moles' cells that have one, strength of veins.
        wrap: softness of grazing light.
        ambient: light of the surroundings.
        plain_contrast: of what is not skin.
        seed: of the mottling.
        background: radiance where nothing is hit, added everywhere.
        image: float32 (pixels, 3), added to.
    """
    specular, exponent, patches, roughness = sheen[0], sheen[1], sheen[2], sheen[3]
    normalisation = (exponent + 8.0) / 8.0
    chroma_seed = mixed(seed + np.uint64(101))
    weight = 1.0 / samples
    for i in range(primitive.shape[0]):
        pixel = i // samples
        face = primitive[i]
        if face < 0:
            for channel in range(3):
                image[pixel, channel] += weight * background
            continue
        b1, b2 = np.float64(second[i]), np.float64(third[i])
        b0 = 1.0 - b1 - b2
        v0, v1, v2 = faces[face, 0], faces[face, 1], faces[face, 2]
        px = b0 * vertices[v0, 0] + b1 * vertices[v1, 0] + b2 * vertices[v2, 0]
        py = b0 * vertices[v0, 1] + b1 * vertices[v1, 1] + b2 * vertices[v2, 1]
        pz = b0 * vertices[v0, 2] + b1 * vertices[v1, 2] + b2 * vertices[v2, 2]
        nx = b0 * attributes[v0, 0] + b1 * attributes[v1, 0] + b2 * attributes[v2, 0]
        ny = b0 * attributes[v0, 1] + b1 * attributes[v1, 1] + b2 * attributes[v2, 1]
        nz = b0 * attributes[v0, 2] + b1 * attributes[v1, 2] + b2 * attributes[v2, 2]
        length = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
        nx, ny, nz = nx * length, ny * length, nz * length
        ex, ey, ez = centre[0] - px, centre[1] - py, centre[2] - pz
        distance = math.sqrt(ex * ex + ey * ey + ez * ez)
        ex, ey, ez = ex / distance, ey / distance, ez / distance
        footprint = distance / focal_px
        bare = material[face] == 0
        gx, gy, gz, sheen_here = nx, ny, nz, specular
        if bare and specular > 0.0 and roughness > 0.0:
            gx += roughness * _gradient_noise(px / 0.8, py / 0.8, pz / 0.8, mixed(seed + np.uint64(102)))
            gy += roughness * _gradient_noise(px / 0.8, py / 0.8, pz / 0.8, mixed(seed + np.uint64(103)))
            gz += roughness * _gradient_noise(px / 0.8, py / 0.8, pz / 0.8, mixed(seed + np.uint64(104)))
            length = 1.0 / math.sqrt(gx * gx + gy * gy + gz * gz)
            gx, gy, gz = gx * length, gy * length, gz * length
        if bare and specular > 0.0 and patches > 0.0:
            patch = _gradient_noise(px / 11.0, py / 11.0, pz / 11.0, mixed(seed + np.uint64(105)))
            sheen_here *= max(0.0, 1.0 + patches * patch)

        diffuse = ambient * (b0 * attributes[v0, 4] + b1 * attributes[v1, 4] + b2 * attributes[v2, 4])
        glint = 0.0
        for k in range(lights.shape[0]):
            seen = b0 * attributes[v0, 8 + k] + b1 * attributes[v1, 8 + k] + b2 * attributes[v2, 8 + k]
            if seen <= 0.0:
                continue
            lx, ly, lz = lights[k, 0] - px, lights[k, 1] - py, lights[k, 2] - pz
            r2 = lx * lx + ly * ly + lz * lz
            r = math.sqrt(r2)
            lx, ly, lz = lx / r, ly / r, lz / r
            cosine = nx * lx + ny * ly + nz * lz
            strength = seen * lights[k, 3] / r2
            diffuse += strength * max(0.0, (cosine + wrap) / (1.0 + wrap))
            if cosine > 0.0 and sheen_here > 0.0:
                hx, hy, hz = lx + ex, ly + ey, lz + ez
                half = (gx * hx + gy * hy + gz * hz) / math.sqrt(hx * hx + hy * hy + hz * hz)
                if half > 0.0:
                    glint += strength * cosine * sheen_here * normalisation * half**exponent

        if not bare:
            tone = plain_contrast * _gradient_noise(px / 5.0, py / 5.0, pz / 5.0, seed)
            for channel in range(3):
                shine = colours[1 + material[face], channel] * diffuse * math.exp(tone)
                image[pixel, channel] += weight * (shine + background)
            continue
        areola = b0 * attributes[v0, 3] + b1 * attributes[v1, 3] + b2 * attributes[v2, 3]
        paint_r, paint_g, paint_b = paint(px, py, pz, areola, footprint, colours, spectrum, marks, seed, chroma_seed)
        for channel in range(3):
            colour = paint_r if channel == 0 else paint_g if channel == 1 else paint_b
            soft = (
                b0 * attributes[v0, 5 + channel] + b1 * attributes[v1, 5 + channel] + b2 * attributes[v2, 5 + channel]
            )
            image[pixel, channel] += weight * (min(colour, 0.95) * max(diffuse + soft, 0.0) + glint + background)
