"""A scanner's files, made up: the front of a trunk as OBJ, its material and its picture."""

from pathlib import Path

import numpy as np
from PIL import Image
from tests.unit.measure.trunks import trunk_mesh

SKIN, DARK = (210, 160, 140), (90, 40, 30)
"""Colours of the picture's upper and lower half, sRGB."""


def texture(path: Path, size_wh: tuple[int, int] = (64, 64)) -> Path:
    width, height = size_wh
    pixels = np.empty((height, width, 3), dtype=np.uint8)
    pixels[: height // 2], pixels[height // 2 :] = SKIN, DARK
    Image.fromarray(pixels).save(path, quality=95, subsampling=0)
    return path


def scanned(folder: Path, *, step_mm: float = 4.0, scale: float = 0.1, name: str = "Muster Anna") -> Path:
    """A scan of the front in cm, covered by height: its head half is `SKIN`, the rest `DARK`."""
    folder.mkdir(exist_ok=True)
    mesh = trunk_mesh(step_mm)
    front = mesh.faces[(mesh.vertices[mesh.faces][:, :, 2] > 0).all(axis=1)]
    front = front[(front < len(mesh.vertices) - 2).all(axis=1)]  # without the lids
    used, faces = np.unique(front, return_inverse=True)
    points, faces = mesh.vertices[used], faces.reshape(-1, 3) + 1
    low, high = points.min(axis=0), points.max(axis=0)
    uv = (points[:, :2] - low[:2]) / (high - low)[:2] * 0.98 + 0.01
    lines = ["# Patient: Anna Muster", f"mtllib {name}.mtl", "g Muster", "usemtl skin of Muster"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points * scale]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv]
    lines += ["f " + " ".join(f"{corner}/{corner}" for corner in face) for face in faces]
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    (folder / f"{name}.mtl").write_text(f"newmtl skin of Muster\nKd 1 1 1\nmap_Kd -s 1 1 1 C:\\Scans\\{name}.JPG\n")
    texture(folder / f"{name}.jpg")
    return folder / f"{name}.obj"
