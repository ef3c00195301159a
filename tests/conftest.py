"""Annotated shapes and dtypes are checked while the tests run; third-party data are found or skipped."""

import os
from pathlib import Path

# Tests fill the cores already; BLAS reads this when NumPy is loaded first, by the next import at the earliest.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from jaxtyping import install_import_hook

# Numba compiles kernel modules and the lens, and cannot see through a checking wrapper; the command line has no arrays.
_CHECKED = ("base.photograph", "matching.match", "matching.rectify", "surface.range_image", "measure")
REPOSITORY = Path(__file__).resolve().parents[1]
_PACKAGE = REPOSITORY / "src" / "mammometry"
_WITHOUT_KERNELS = [
    ".".join(path.relative_to(_PACKAGE).with_suffix("").parts)
    for package in ("calibration", "geometry")
    for path in (_PACKAGE / package).rglob("*.py")
    if not path.stem.endswith("kernels") and path.stem not in ("__init__", "lens")
]
install_import_hook([f"mammometry.{name}" for name in (*_CHECKED, *_WITHOUT_KERNELS)], "beartype.beartype")


@pytest.fixture(scope="session")
def repository() -> Path:
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    folder = REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("third-party captures are not beside the repository (shared/data)")
    return folder
