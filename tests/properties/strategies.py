"""Hypothesis strategies for geometry; small enough ranges that float64 tolerances can be argued."""

import numpy as np
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

    Within these limits Brown's radial polynomial grows monotonically out to the image corners, so it has an inverse.
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
    return Camera(
        name="any",
        size_wh=(width, height),
        matrix=matrix,
        distortion=distortion,
        camera_from_world=draw(transforms()),
    )
