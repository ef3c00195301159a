"""Hypothesis strategies for geometry; small enough ranges that float64 tolerances can be argued."""

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

METRE_MM = 1000.0


def vectors(limit: float) -> st.SearchStrategy[np.ndarray]:
    """Three finite numbers within ±limit."""
    return hnp.arrays(np.float64, 3, elements=st.floats(-limit, limit, allow_subnormal=False))


@st.composite
def transforms(draw: st.DrawFn, limit_mm: float = METRE_MM) -> Transform:
    """Rotations up to π about any axis (the identity and near-π among them), translations within a metre."""
    axis = draw(vectors(1.0))
    norm = np.linalg.norm(axis)
    axis = axis / norm if norm > 1e-3 else np.array([0.0, 0.0, 1.0])
    angle_rad = draw(st.floats(-np.pi, np.pi, allow_subnormal=False))
    return Transform.from_rotation_vector(axis * angle_rad, draw(vectors(limit_mm)))


def points(n: int = 7, limit_mm: float = METRE_MM) -> st.SearchStrategy[np.ndarray]:
    """`n` points within ±limit_mm, (n, 3)."""
    return hnp.arrays(np.float64, (n, 3), elements=st.floats(-limit_mm, limit_mm, allow_subnormal=False))


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    """Cameras of photographic use: 30–70° across, principal point near the middle, distortion of ordinary lenses.

    Brown's radial polynomial grows monotonically to a tenth beyond the image corners, so it has an inverse there. The
    widest fields with the strongest barrel would fold: those are not drawn.
    """
    width = draw(st.sampled_from((640, 1126, 4504)))
    height = width * 2 // 3
    focal = width * draw(st.floats(0.75, 2.0))
    matrix = np.array(
        [
            [focal, 0.0, width * draw(st.floats(0.45, 0.55))],
            [0.0, focal * draw(st.floats(0.98, 1.02)), height * draw(st.floats(0.45, 0.55))],
            [0.0, 0.0, 1.0],
        ]
    )
    distortion = np.array(
        [
            draw(st.floats(-0.15, 0.15)),
            draw(st.floats(-0.05, 0.05)),
            draw(st.floats(-0.002, 0.002)),
            draw(st.floats(-0.002, 0.002)),
            draw(st.floats(-0.01, 0.01)),
        ]
    )
    corners = np.array([(0, 0), (width, 0), (0, height), (width, height)], dtype=np.float64)
    reach = np.linalg.norm((corners - matrix[:2, 2]) / np.diag(matrix)[:2], axis=1).max()
    assume(_grows_to(1.1 * reach, distortion))
    return Camera(
        name="any", size_wh=(width, height), matrix=matrix, distortion=distortion, camera_from_world=draw(transforms())
    )


def _grows_to(reach: float, distortion: np.ndarray) -> bool:
    """Whether the distorted radius `r + k1 r³ + k2 r⁵ + k3 r⁷` rises until it has reached `reach`."""
    r = np.linspace(0, 2 * reach, 400)
    k1, k2, _, _, k3 = distortion
    distorted = r * (1 + r**2 * (k1 + r**2 * (k2 + r**2 * k3)))
    falls = np.flatnonzero(np.diff(distorted) <= 0)
    return bool(distorted[falls[0] if len(falls) else -1] >= reach)
