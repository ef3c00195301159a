"""One body as many files: with lids, open ends, unequal arms, turned, and cut differently.

    python -m benchmarks.accuracy.variants --women 9700-9702 --bodies ../shared/data/scans

Each variant shows the same breasts, so each must give the volumes of the front as it is, or ask. `--head` and `--ahead`
are never given. A volume that differs by more than 2 %, or a side that is called empty, is a silent wrong answer. Even
numbers stand, odd ones lean.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.accuracy.scans import measured
from benchmarks.names import known
from mammometry.geometry import Float64, TriangleMesh
from mammometry.geometry.arrays import Array
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import read_foreign
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.scan import clean_front
from mammometry.simulate.subjects.registry import make_subject

_EDGE_MM = 2.5  # of the bodies' triangles, on the breasts
_SAME = 0.02  # share of a volume by which variants may differ
_TURNS = 3  # random rotations of each form
_WAISTS_MM = (-150.0, -200.0, -260.0)  # heights, from the nipples, at which the trunk is cut
_NECK_MM, _WAIST_MM, _ARM_MM = 215.0, -300.0, 195.0  # where the body with its back is cut open
_SHORTER_MM = 25.0  # one arm is cut so much nearer to the trunk


def kept(mesh: TriangleMesh, inside: Array) -> TriangleMesh:
    """The largest part of a mesh among the vertices that are kept."""
    part = mesh.submesh(inside[mesh.faces].all(axis=1))
    _, label = part.components()
    return part.submesh(label[part.faces[:, 0]] == np.argmax(np.bincount(label[part.faces[:, 0]])))


def lidded(mesh: TriangleMesh) -> TriangleMesh:
    """Close each opening by a fan around its middle. That of the widest one, a front's rim, is a flat lid too."""
    vertices, faces = [mesh.vertices], [mesh.faces]
    count = len(mesh.vertices)
    for loop in openings(mesh):
        following = np.roll(loop, -1)
        faces.append(np.stack([following, loop, np.full(len(loop), count)], axis=1).astype(np.int32))
        vertices.append(mesh.vertices[loop].mean(axis=0, keepdims=True))
        count += 1
    return TriangleMesh(vertices=np.concatenate(vertices), faces=np.concatenate(faces))


def openings(mesh: TriangleMesh) -> Iterator[Array]:
    """Yield the simple loops of edges with one face, in their faces' direction."""
    start, end = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    both = {(int(a), int(b)) for a, b in zip(start, end, strict=True)}
    follow = {a: b for a, b in both if (b, a) not in both}
    while follow:
        first, here = follow.popitem()
        loop = [first]
        while here != first and here in follow:
            loop.append(here)
            here = follow.pop(here)
        if here == first and len(loop) > 2:
            yield np.array(loop)


def turned(mesh: TriangleMesh, seed: int) -> TriangleMesh:
    """The mesh in any direction."""
    rotation = Rotation.random(rng=np.random.default_rng([seed, 56])).as_matrix()
    return TriangleMesh(vertices=mesh.vertices @ rotation.T, faces=mesh.faces)


def with_back(mesh: TriangleMesh, shorter_mm: float) -> TriangleMesh:
    """A whole body, open at neck, waist and arms. One arm is cut nearer to the trunk."""
    x, y, _ = mesh.vertices.T
    return kept(mesh, (y < _NECK_MM) & (y > _WAIST_MM) & (x < _ARM_MM) & (x > shorter_mm - _ARM_MM))


def variants(front: TriangleMesh, whole: TriangleMesh | None, nipples_y: float) -> Iterator[tuple[str, TriangleMesh]]:
    """Yield the name and mesh of each variant. The first is the front as it is."""
    yield "front", front
    yield "front with lids", lidded(front)
    for waist_mm in _WAISTS_MM:
        yield f"front cut at {waist_mm:.0f} mm", kept(front, front.vertices[:, 1] > nipples_y + waist_mm)
    for seed in range(_TURNS):
        yield f"front, turned {seed}", turned(front, seed)
        yield f"front with lids, turned {seed}", turned(lidded(front), seed)
    if whole is not None:
        for name, shorter_mm in (("with its back, open", 0.0), ("with its back, one arm shorter", _SHORTER_MM)):
            yield name, with_back(whole, shorter_mm)
            yield f"{name}, with lids", lidded(with_back(whole, shorter_mm))
            yield f"{name}, turned", turned(with_back(whole, shorter_mm), 7)


def report(name: str, made: Iterator[tuple[str, TriangleMesh]]) -> tuple[int, int, int]:
    """Print a row for each variant. The number that agree, that ask, and that are silently wrong."""
    expected: dict[str, float] = {}
    right = asked = wrong = 0
    for variant, mesh in made:
        with tempfile.TemporaryDirectory(prefix="mammometry-variants-") as folder:
            path = Path(folder) / "scan.ply"
            write_ply(path, mesh, {}, comments=())
            row = measured(path, report=False)
        volumes = {side: own["volume_cc"] for side, own in row["sides"].items()}
        expected = expected or volumes
        if row["refused"]:
            asked, verdict = asked + 1, f"asked: {row['refused'].splitlines()[0][:150]}"
        elif volumes.keys() == expected.keys() and all(
            abs(volumes[side] / expected[side] - 1) <= _SAME for side in volumes
        ):
            right, verdict = right + 1, "the same"
        else:
            wrong, verdict = wrong + 1, "**another answer**"
        shown = ", ".join(f"{side} {volume:.0f}" for side, volume in volumes.items()) or "–"
        print(f"| {name} | {variant} | {shown} | {verdict} |", flush=True)
    return right, asked, wrong


def made_woman(number: int) -> Iterator[tuple[str, TriangleMesh]]:
    """Variants of a virtual woman."""
    text = "posture=standing" if number % 2 == 0 else "posture=leaning"
    reshape = partial(disturbed, stage="patient", situation=parse_situation(text), seed=number)
    solid = make_subject(f"torso_{number}", 0, edge_mm=_EDGE_MM, reshape=reshape)
    nipples: Float64[Array, "k 3"] = np.concatenate([solid.landmarks[f"nipple_{side}"] for side in solid.breasts])
    yield from variants(clean_front(solid).mesh, solid.mesh, float(nipples[:, 1].mean()))


def made_shared(path: Path) -> Iterator[tuple[str, TriangleMesh]]:
    """Variants of a shared body's clean front."""
    mesh = read_foreign(path, "mm").mesh
    foremost = mesh.vertices[mesh.vertices[:, 2] > np.quantile(mesh.vertices[:, 2], 0.97)]
    yield from variants(mesh, None, float(np.median(foremost[:, 1])))


def main() -> None:
    """Make, measure, count."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--women", default="9700-9702", help="first and last, as 9700-9702")
    parser.add_argument("--bodies", type=Path, default=None, help="folder of the shared bodies")
    parser.add_argument("--shared", nargs="*", default=["body_2", "hanging_1"], help="shared bodies to take")
    arguments = parser.parse_args()
    if arguments.bodies is not None:
        names = [path.name.removesuffix("_clean.ply") for path in sorted(arguments.bodies.glob("*_clean.ply"))]
        known("bodies", arguments.shared, names)
    first, _, last = arguments.women.partition("-")
    print("| body | variant | cc | answer |\n| --- | --- | --- | --- |")
    counts = [report(f"woman {number}", made_woman(number)) for number in range(int(first), int(last or first) + 1)]
    if arguments.bodies is not None:
        counts += [report(name, made_shared(arguments.bodies / f"{name}_clean.ply")) for name in arguments.shared]
    right, asked, wrong = np.sum(counts, axis=0)
    print(f"\n{right} of {right + asked + wrong} the same within 2 %, {asked} asked, {wrong} silently another answer")


if __name__ == "__main__":
    main()
