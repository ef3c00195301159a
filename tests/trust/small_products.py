"""Small products of every way to be kept, for a results folder that is quickly filled.

As a program: ``python small_products.py FOLDER VERSION`` makes all of them there.
"""

import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from mammometry.base.errors import BusyError
from mammometry.base.progress import Progress
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.results.store import Store
from mammometry.job.products import Key

NAMES = ("mesh", "blocked", "boundaries", "pictures")


def key(product: str, version: int = 1) -> Key:
    stage = "measure" if product == "boundaries" else "surface"
    return Key(stage=stage, product=product, version=version, settings={"cube_mm": 0.5}, inputs={"photograph": "abc"})


def mesh(version: int) -> TriangleMesh:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, version]], dtype=np.float64)
    return TriangleMesh(vertices=corners, faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32))


def pictures(version: int) -> Mapping[str, bytes]:
    """One that stays, one that changes, one in a folder, one that only this version has."""
    return {"a.png": b"same", "b.png": b"%d" % version, "sub/c.png": b"c%d" % version, f"only-{version}.png": b"x" * 50}


def make(store: Store, product: str, version: int = 1) -> None:
    """Have a product made or recalled."""
    if product == "pictures":

        def write(folder: Path, progress: Progress) -> None:
            for name, data in pictures(version).items():
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_bytes(data)

        store.write_folder(key(product, version), lambda: write)
        return
    values = {"mesh": mesh(version), "blocked": (1, float(version), np.arange(40.0) * version), "boundaries": ()}
    maker: Callable[[Progress], object] = lambda progress: values[product]  # noqa: E731
    store.recall(key(product, version), lambda: maker)


def contents(results: Path) -> dict[str, bytes]:
    """All files but records and hidden ones: path → bytes."""
    return {
        path.relative_to(results).as_posix(): path.read_bytes()
        for path in sorted(results.rglob("*"))
        if path.is_file() and path.name != "provenance.json" and not path.relative_to(results).parts[0].startswith(".")
    }


def main(folder: Path, version: int) -> None:
    """Make all of them, once the folder is free."""
    while True:
        store = Store(folder)
        try:
            with store.taken():
                for name in NAMES:
                    make(store, name, version)
                return
        except BusyError:
            time.sleep(0.02)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
