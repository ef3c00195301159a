"""Compiled kernel that shades a mesh's picture.

A plain NumPy version is in tests/unit/report/test_shading.py.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Float32, Int32, UInt8


@kernel
def shaded(
    seen: Int32[Array, "h w"],
    weights: Float32[Array, "h w 3"],
    faces: Int32[Array, "m 3"],
    colours: Float32[Array, "k 3"],
    by_face: bool,
    normals: Float32[Array, "n 3"],
    lit: float,
    lights: Float32[Array, "l 3"],
    ambient: float,
) -> UInt8[Array, "h2 w2 4"]:
    """Picture of the visible faces, RGBA, at half the size.

    A pixel's colour is the mean of those of its four samples that show a face.

    Args:
        seen: face at each sample, −1 if there is none.
        weights: barycentric weights of its corners at the sample.
        faces: vertex indices of the mesh's faces.
        colours: colours of vertices or of faces, 0…1.
        by_face: whether the colours are those of faces.
        normals: unit vertex normals, right, up and towards the viewer.
        lit: strength of the shading, 0…1.
        lights: direction towards each light, times its strength.
        ambient: strength of the ambient light.
    """
    height, width = seen.shape[0] // 2, seen.shape[1] // 2
    picture = np.zeros((height, width, 4), dtype=np.uint8)
    for row in range(height):
        for column in range(width):
            count = 0
            red, green, blue = 0.0, 0.0, 0.0
            for sample in range(4):
                y, x = 2 * row + sample // 2, 2 * column + sample % 2
                face = seen[y, x]
                if face < 0:
                    continue
                count += 1
                r, g, b, right, up, towards = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for corner in range(3):
                    weight, vertex = weights[y, x, corner], faces[face, corner]
                    of = face if by_face else vertex
                    r += weight * colours[of, 0]
                    g += weight * colours[of, 1]
                    b += weight * colours[of, 2]
                    right += weight * normals[vertex, 0]
                    up += weight * normals[vertex, 1]
                    towards += weight * normals[vertex, 2]
                # The inside of a mesh that is open at the back is visible there. It is lit like the outside.
                length = max(np.sqrt(right * right + up * up + towards * towards), 1e-9)
                length = -length if towards < 0 else length
                light = ambient
                for number in range(len(lights)):
                    along = right * lights[number, 0] + up * lights[number, 1] + towards * lights[number, 2]
                    light += max(along / length, 0.0)
                share = 1.0 + lit * (light - 1.0)
                red += min(max(r * share, 0.0), 1.0)
                green += min(max(g * share, 0.0), 1.0)
                blue += min(max(b * share, 0.0), 1.0)
            if count:
                picture[row, column, 0] = np.uint8(red / count * 255 + 0.5)
                picture[row, column, 1] = np.uint8(green / count * 255 + 0.5)
                picture[row, column, 2] = np.uint8(blue / count * 255 + 0.5)
                picture[row, column, 3] = np.uint8(count / 4 * 255 + 0.5)
    return picture
