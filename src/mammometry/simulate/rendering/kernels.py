"""Compiled inner loops of the renderer: rays, board patterns, sensor.

Plain NumPy versions are in tests/unit/simulate/test_kernels.py. The kernels release the GIL, so that images are
rendered by as many threads as there are cores. Every result depends only on its own seed.
"""

import math

import numpy as np

from mammometry.base.machine.compiled import kernel, small_kernel
from mammometry.geometry.arrays import Array
from mammometry.geometry.lens_kernels import undistorted

POISSON_BELOW = 40.0
"""Number of photons above which a normal distribution differs from Poisson's by less than 1.1 %."""

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
U16 = np.uint64(0xFFFF)


@small_kernel
def mixed(state: np.uint64) -> np.uint64:
    """splitmix64's finaliser: 64 well-mixed bits of a counter."""
    state = (state ^ (state >> np.uint64(30))) * _MIX_1
    state = (state ^ (state >> np.uint64(27))) * _MIX_2
    return state ^ (state >> np.uint64(31))


@kernel
def rays(uv: Array, lens: Array, rotation: Array, directions: Array) -> None:
    """Unit directions (n, 3), world frame, through distorted pixels `uv` (n, 2).

    `lens` is fx, fy, cx, cy, k1, k2, p1, p2, k3; `rotation` is camera from world. Written to `directions` (float32).
    """
    x, y, coefficients = 0.0, 0.0, lens[4:]
    for i in range(uv.shape[0]):
        xd = (uv[i, 0] - lens[2]) / lens[0]
        yd = (uv[i, 1] - lens[3]) / lens[1]
        if i == 0 or abs(xd - x) + abs(yd - y) > 0.05:
            x, y = xd, yd
        x, y, _, _, _ = undistorted(xd, yd, coefficients, x, y)
        scale = 1.0 / math.sqrt(x * x + y * y + 1.0)
        for axis in range(3):
            directions[i, axis] = (rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis]) * scale


@kernel
def in_plane(
    row: Array,
    column: Array,
    offsets: Array,
    lens: Array,
    rotation: Array,
    centre: Array,
    faces: Array,
    vertices: Array,
    primitive: Array,
    second: Array,
    third: Array,
) -> None:
    """Intersections of the rays of n pixels with the planes of their faces.

    The rays go through the pixels' areas. The faces are those at the pixels' centres. The lens is linearised within a
    pixel, with an error below a thousandth of a pixel.

    Args:
        row: (n,) of the pixels.
        column: (n,) of the pixels.
        offsets: (m, 2) positions in the pixel, column first, −0.5 … 0.5.
        lens: fx, fy, cx, cy, k1, k2, p1, p2, k3.
        rotation: camera from world.
        centre: perspective centre, world, mm.
        faces: (k, 3) vertex indices.
        vertices: (v, 3) world, mm.
        primitive: (n,) the faces.
        second: (n · m,) barycentric weight of the face's second vertex. Overwritten, except for faces seen edge-on.
        third: (n · m,) barycentric weight of its third vertex, likewise.
    """
    x, y, coefficients = 0.0, 0.0, lens[4:]
    to_second, to_third = np.empty(3), np.empty(3)
    normal, across_second, across_third = np.empty(3), np.empty(3), np.empty(3)
    for i in range(row.shape[0]):
        xd, yd = (column[i] - lens[2]) / lens[0], (row[i] - lens[3]) / lens[1]
        if i == 0 or abs(xd - x) + abs(yd - y) > 0.05:
            x, y = xd, yd
        x, y, jxx, jxy, jyy = undistorted(xd, yd, coefficients, x, y)
        determinant = jxx * jyy - jxy * jxy
        v0, v1, v2 = faces[primitive[i], 0], faces[primitive[i], 1], faces[primitive[i], 2]
        for a in range(3):
            to_second[a] = np.float64(vertices[v1, a]) - np.float64(vertices[v0, a])
            to_third[a] = np.float64(vertices[v2, a]) - np.float64(vertices[v0, a])
        # A ray d meets the plane where its weights are d · across / d · normal (Möller and Trumbore 1997).
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            from_b, from_c = centre[b] - vertices[v0, b], centre[c] - vertices[v0, c]
            normal[a] = to_third[b] * to_second[c] - to_third[c] * to_second[b]
            across_second[a] = to_third[b] * from_c - to_third[c] * from_b
            across_third[a] = from_b * to_second[c] - from_c * to_second[b]
        size = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        for k in range(offsets.shape[0]):
            ox, oy = offsets[k, 0] / lens[0], offsets[k, 1] / lens[1]
            sx = x + (jyy * ox - jxy * oy) / determinant
            sy = y + (jxx * oy - jxy * ox) / determinant
            slope, weight_2, weight_3 = 0.0, 0.0, 0.0
            for a in range(3):
                direction = rotation[0, a] * sx + rotation[1, a] * sy + rotation[2, a]
                slope += direction * normal[a]
                weight_2 += direction * across_second[a]
                weight_3 += direction * across_third[a]
            if abs(slope) > 0.01 * size:
                second[i * offsets.shape[0] + k] = weight_2 / slope
                third[i * offsets.shape[0] + k] = weight_3 / slope


@small_kernel
def _ink(x: float, y: float, layout: Array, bits: Array) -> int:
    """Print of a board at (x, y), mm: 1 white, 0 black, −1 outside."""
    if x < layout[5] or y < layout[6] or x > layout[7] or y > layout[8]:
        return -1
    kind, columns, rows, step, size = layout[0], int(layout[1]), int(layout[2]), layout[3], layout[4]
    if kind > 0.0:  # circles: 1 square grid, 2 staggered
        j = int(min(max(math.floor(y / step + 0.5), 0.0), rows - 1.0))
        shift = float(j & 1) if kind > 1.0 else 0.0
        i = int(min(max(math.floor((x / step - shift) / kind + 0.5), 0.0), columns - 1.0))
        dx, dy = x - (kind * i + shift) * step, y - j * step
        return 1 if dx * dx + dy * dy > size * size else 0
    i, j = math.floor(x / step), math.floor(y / step)
    if i < 0 or j < 0 or i >= columns or j >= rows:
        return 1
    which = bits[j, i, 0, 0]
    if which <= 1:  # a plain square
        return which
    cells = bits.shape[2] - 1
    margin = (step - size) / 2.0
    a = math.floor((x - i * step - margin) / size * cells)
    b = math.floor((y - j * step - margin) / size * cells)
    if a < 0 or b < 0 or a >= cells or b >= cells:
        return 1
    return bits[j, i, b + 1, a + 1]


@kernel
def board(
    lens: Array,
    rotation: Array,
    origin: Array,
    layout: Array,
    bits: Array,
    irradiance: Array,
    shades: Array,
    offsets: Array,
    aperture: Array,
    focus_mm: float,
    window: Array,
    image: Array,
) -> None:
    """Write the radiance of a flat printed board to `image` (h, w). White in full light is 1.

    Args:
        lens: fx, fy, cx, cy, k1, k2, p1, p2, k3.
        rotation: board from camera.
        origin: the camera's centre in the board's frame, mm.
        layout: pattern (0 squares, 1 circles in a square grid, 2 in a staggered one), its columns and rows, side of a
            square or distance of rows, side of a marker or radius of a circle, and the paper's least x and y and
            greatest x and y; mm.
        bits: (rows, columns, c + 1, c + 1): [j, i, 0, 0] is 0 black, 1 white, 2 marker, followed by its c × c cells.
        irradiance: (rows, columns) over the paper, interpolated. White in full light is 1.
        shades: reflectance of black and of white, and the radiance outside the board.
        offsets: (m, 2) sub-pixel positions at which pixels on an edge are sampled.
        aperture: (m, 2) positions of these samples in the lens, mm along the camera's x and y. 0 for a pinhole.
        focus_mm: depth of the sharp plane.
        window: rows from and to, columns from and to in which the board can be.
        image: float32 (h, w), filled with `shades[2]`.
    """
    left, top, right, bottom = layout[5], layout[6], layout[7], layout[8]
    coefficients, opening = lens[4:], 0.0
    for k in range(aperture.shape[0]):
        opening = max(opening, abs(aperture[k, 0]), abs(aperture[k, 1]))
    for row in range(window[0], window[1]):
        yd = (row - lens[3]) / lens[1]
        x, y = (window[2] - lens[2]) / lens[0], yd
        uxx, uyx = 0.0, 0.0
        for column in range(window[2], window[3]):
            xd = (column - lens[2]) / lens[0]
            x += uxx  # extrapolated from the previous pixel, a good start
            y += uyx
            x, y, jxx, jxy, jyy = undistorted(xd, yd, coefficients, x, y)
            dx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
            dy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
            dz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
            if dz <= 1e-6 or origin[2] >= 0.0:  # seen from behind, or along the plane
                continue
            t = -origin[2] / dz
            bx, by = origin[0] + t * dx, origin[1] + t * dy
            # mm on the board per ideal unit, then per pixel: the inverse of the lens's Jacobian, over the focal length
            bxx = t * (rotation[0, 0] - dx / dz * rotation[2, 0])
            bxy = t * (rotation[0, 1] - dx / dz * rotation[2, 1])
            byx = t * (rotation[1, 0] - dy / dz * rotation[2, 0])
            byy = t * (rotation[1, 1] - dy / dz * rotation[2, 1])
            determinant = jxx * jyy - jxy * jxy
            uxx, uyy = jyy / determinant / lens[0], jxx / determinant / lens[1]
            uxy, uyx = -jxy / determinant / lens[1], -jxy / determinant / lens[0]
            mxx, mxy = bxx * uxx + bxy * uyx, bxx * uxy + bxy * uyy
            myx, myy = byx * uxx + byy * uyx, byx * uxy + byy * uyy
            unsharp = opening * abs(1.0 / t - 1.0 / focus_mm)
            hx = (abs(mxx) + abs(mxy)) * 0.51 + (abs(bxx) + abs(bxy)) * unsharp
            hy = (abs(myx) + abs(myy)) * 0.51 + (abs(byx) + abs(byy)) * unsharp
            if bx + hx < left or by + hy < top or bx - hx > right or by - hy > bottom:
                continue
            gx = min(max((bx - left) / (right - left), 0.0), 1.0) * (irradiance.shape[1] - 1)
            gy = min(max((by - top) / (bottom - top), 0.0), 1.0) * (irradiance.shape[0] - 1)
            cx, cy = min(int(gx), irradiance.shape[1] - 2), min(int(gy), irradiance.shape[0] - 2)
            gx -= cx
            gy -= cy
            light = (1.0 - gy) * ((1.0 - gx) * irradiance[cy, cx] + gx * irradiance[cy, cx + 1])
            light += gy * ((1.0 - gx) * irradiance[cy + 1, cx] + gx * irradiance[cy + 1, cx + 1])
            centre = _ink(bx, by, layout, bits)
            plain = True
            for corner in range(4):
                ex = bx + (hx if corner & 1 else -hx)
                ey = by + (hy if corner & 2 else -hy)
                if _ink(ex, ey, layout, bits) != centre:
                    plain = False
                    break
            if plain:
                image[row, column] = light * shades[centre] if centre >= 0 else shades[2]
                continue
            total = 0.0
            for k in range(offsets.shape[0]):
                ox, oy = offsets[k, 0], offsets[k, 1]
                sx, sy = bx + mxx * ox + mxy * oy, by + myx * ox + myy * oy
                if opening > 0.0:  # from a point of the lens through this ray's point in the sharp plane
                    ax = rotation[0, 0] * aperture[k, 0] + rotation[0, 1] * aperture[k, 1]
                    ay = rotation[1, 0] * aperture[k, 0] + rotation[1, 1] * aperture[k, 1]
                    az = rotation[2, 0] * aperture[k, 0] + rotation[2, 1] * aperture[k, 1]
                    along = -(origin[2] + az) / (focus_mm * dz - az)
                    sx += ax + along * (focus_mm * dx - ax) - t * dx
                    sy += ay + along * (focus_mm * dy - ay) - t * dy
                ink = _ink(sx, sy, layout, bits)
                total += light * shades[ink] if ink >= 0 else shades[2]
            image[row, column] = total / offsets.shape[0]


@kernel
def _poisson(mean: float, bits: np.uint64) -> float:
    """Number of photons: the smallest whose Poisson distribution function reaches a random number."""
    left = (np.float64(bits >> np.uint64(11)) + 0.5) * 2.0**-53
    term, count = math.exp(-mean), 0.0
    while left > term and count < 200.0:
        left -= term
        count += 1.0
        term *= mean / count
    return count


@kernel
def develop(
    image: Array,
    taps: Array,
    vignetting: float,
    electrons: float,
    read_noise: float,
    seed: np.uint64,
    table: Array,
    photograph: Array,
) -> None:
    """Convert radiance to the sensor's output: blur, vignetting, noise, transfer curve.

    Args:
        image: float32 (h, w, 1 or 3), 1 is full scale.
        taps: odd number of weights of the separable point spread function.
        vignetting: loss of light in the image's corner, 0…1, growing with the square of the distance from the centre.
        electrons: at full scale. Photons have a Poisson distribution, a normal one above `POISSON_BELOW`.
        read_noise: electrons.
        seed: seed of this image's noise.
        table: uint8 or uint16 (65536,): the transfer curve.
        photograph: of the same type, (h, w, 3), overwritten.
    """
    height, width, channels = image.shape
    radius, across = taps.shape[0] // 2, width * channels
    ring = np.zeros((taps.shape[0], across), dtype=np.float32)
    signal, normal = np.zeros(across), np.zeros(width * 3)
    diagonal2 = 0.25 * (width * width + height * height)
    first = min(radius, width)  # columns at either side whose kernel extends beyond the image
    done = -1  # the last row that was blurred along the row
    for row in range(height):
        while done < min(row + radius, height - 1):
            done += 1
            target, line = ring[done % taps.shape[0]], image[done].reshape(across)
            for place in range(across):
                target[place] = np.float32(0.0)
            for k in range(taps.shape[0]):
                shift = (k - radius) * channels
                for place in range(first * channels, across - first * channels):
                    target[place] += taps[k] * line[place + shift]
                for column in range(first):
                    for channel in range(channels):
                        source = min(max(column + k - radius, 0), width - 1)
                        target[column * channels + channel] += taps[k] * line[source * channels + channel]
                for column in range(max(width - first, first), width):
                    for channel in range(channels):
                        source = min(max(column + k - radius, 0), width - 1)
                        target[column * channels + channel] += taps[k] * line[source * channels + channel]
        for place in range(across):
            signal[place] = 0.0
        for k in range(taps.shape[0]):
            target = ring[min(max(row + k - radius, 0), height - 1) % taps.shape[0]]
            for place in range(across):
                signal[place] += taps[k] * target[place]
        before = seed + np.uint64(row * width) * np.uint64(6)
        for place in range(width * 3):
            # Approximately normal: sum of eight uniform numbers of 16 bits, from two counters; variance 8/12.
            counter = before + np.uint64(2 * place)
            one, other = mixed(counter * GOLDEN), mixed((counter + np.uint64(1)) * GOLDEN)
            total = (
                (one & U16) + ((one >> np.uint64(16)) & U16) + ((one >> np.uint64(32)) & U16) + (one >> np.uint64(48))
            )
            total += (other & U16) + ((other >> np.uint64(16)) & U16)
            total += ((other >> np.uint64(32)) & U16) + (other >> np.uint64(48))
            normal[place] = (np.float64(np.int64(total)) / 65535.0 - 4.0) * 1.224744871391589
        dy2 = (row - 0.5 * (height - 1)) ** 2
        for column in range(width):
            fall = 1.0 - vignetting * ((column - 0.5 * (width - 1)) ** 2 + dy2) / diagonal2
            for channel in range(3):
                light = signal[column * channels + (channel if channels == 3 else 0)] * fall
                mean = max(light, 0.0) * electrons
                if mean < POISSON_BELOW:
                    counter = before + np.uint64(6 * column + 2 * channel)
                    arrived = _poisson(mean, mixed(counter * GOLDEN ^ _MIX_1))
                    value = (arrived + read_noise * normal[3 * column + channel]) / electrons
                else:
                    noise = math.sqrt(mean + read_noise * read_noise) / electrons
                    value = light + noise * normal[3 * column + channel]
                photograph[row, column, channel] = table[int(min(max(value, 0.0), 1.0) * 65535.0 + 0.5)]
