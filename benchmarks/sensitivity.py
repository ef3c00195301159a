"""Sensitivity of volumes to every setting and every constant without a source, changed by ± 25 %.

    python -m benchmarks.sensitivity --out build/sensitivity

Four small captures are rendered by seed: a cast, a torso, a torso with a rail before it whose cameras have turned, and
a telephone's scan. Each is measured once. Then numbers are turned, up to sixteen at once, in a process of their own
that takes over every product which they cannot reach: those made without a function that reads one of them, from
unchanged products. They move a volume if the volume, or its interval's width, changes by more than a tenth of that
width, or if something is refused. Numbers that do are halved and turned again, until each that moves it stands alone
(sequential bifurcation: Bettonvil and Kleijnen, European Journal of Operational Research 96, 1997). Two that move it by
the same amount to opposite sides, and are turned together, go unseen; `--together 1` turns each alone. The rows lie in
OUT/rows.jsonl; a second call goes on where the first one ended.

Numbers that compiled kernels hold themselves are not turned, and count as not reached.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import cv2
import numpy as np

import mammometry
from benchmarks.accuracy.scans import woman
from mammometry.api.job import Job, open_session
from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MammometryError
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.job import products
from mammometry.job.products import Key, Product
from mammometry.job.stages.measure import measurements
from mammometry.settings import Settings, names
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.scan import QUALITIES, scan
from mammometry.simulate.session import write_session

SOURCE = Path(mammometry.__file__).parent
STAGES = ("calibration", "matching", "surface", "measure", "geometry", "job")
"""Packages whose constants are turned."""
WITHOUT_SOURCE = "not critical", "by eye"
"""What comments say of constants that have neither a source nor a measurement."""
TURNS = (1.25, 0.75)
MOVED = 0.1
"""Of the interval's width."""
_NO_VOLUME = ("model", "mesh", "landmarks", "symmetry", "dimensions", "lacking", "absent")
"""Products from which no volume is made."""
_SLOW = 20.0
"""Times the base's seconds after which a process is ended."""
CAPTURES: Mapping[str, SessionRecipe | None] = {
    "scan": None,
    "cast": SessionRecipe(),
    "torso": SessionRecipe(rig="reference:front,left,right", subject="torso_3", scale=0.2, seed=42, poses=12),
    "rail": SessionRecipe(
        rig="reference:front,left,right", subject="torso_8", scale=0.2, seed=43, poses=12,
        situation=parse_situation("rail,drift=0.01"),
    ),
}  # fmt: skip
_WOMAN = 41


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """A setting, or a constant of a module."""

    name: str
    """``surface.repair.rho``, or ``surface/repair.py:_STEP``."""
    value: Any
    module: str = ""
    """That defines it. Empty for a setting."""

    @property
    def variable(self) -> str:
        """A constant's own name."""
        return self.name.partition(":")[2]

    def turned(self, factor: float) -> Any:
        """The number times a factor. Counts change by at least 1."""
        return _turned(self.value, factor)


def _turned(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_turned(part, factor) for part in value)
    if isinstance(value, np.generic):
        return type(value)(value.item() * factor)
    if isinstance(value, int):
        step = max(1, round(abs(value) * abs(factor - 1)))
        return value + step if factor > 1 else value - step
    return value * factor


def _is_number(value: Any) -> bool:
    if isinstance(value, tuple):
        return len(value) > 0 and all(map(_is_number, value))
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool) and value != 0


def all_settings() -> Iterator[Number]:
    """Yield the settings that are numbers and not zero."""
    for name in names(Settings()):
        value: Any = Settings()
        for part in name.split("."):
            value = getattr(value, part)
        if _is_number(value):
            yield Number(name=name, value=value)


def constants(everything: bool = False) -> Iterator[Number]:
    """Yield the constants of the stages that have no source.

    Args:
        everything: whether to yield all other numeric constants, too.
    """
    for folder in STAGES:
        for path in sorted((SOURCE / folder).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            if not everything and not any(mark in text for mark in WITHOUT_SOURCE):
                continue
            module = ".".join(("mammometry", *path.relative_to(SOURCE).with_suffix("").parts))
            yield from (
                Number(name=f"{path.relative_to(SOURCE)}:{name}", value=value, module=module)
                for name, value in _constants_in(text, module, everything)
            )


def _constants_in(text: str, module: str, everything: bool) -> Iterator[tuple[str, Any]]:
    lines, body = text.splitlines(), ast.parse(text).body
    for statement, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(statement, (ast.Assign, ast.AnnAssign)):
            continue
        said = lines[statement.lineno - 1 : statement.end_lineno]
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):  # its docstring
            said = [*said, *lines[after.lineno - 1 : after.end_lineno]]
        above = statement.lineno - 2
        while above >= 0 and lines[above].startswith("#"):
            said, above = [lines[above], *said], above - 1
        if not everything and not any(mark in " ".join(said).lower() for mark in WITHOUT_SOURCE):
            continue
        __import__(module)
        known = vars(sys.modules[module])
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        for target in targets:
            for name in ast.walk(target):
                if isinstance(name, ast.Name) and name.id.isupper() and _is_number(known.get(name.id)):
                    yield name.id, known[name.id]


def turn(numbers: Sequence[Number], factor: float) -> Settings:
    """Change numbers in this process: in the returned settings, or in all modules that import them."""
    overrides = []
    for number in numbers:
        value = number.turned(factor)
        if not number.module:
            overrides.append(f"{number.name}={list(value) if isinstance(value, tuple) else value}")
            continue
        own = sys.modules[number.module]
        _assign(own, number.variable, value)
        for module in list(sys.modules.values()):
            if module is not own and module.__name__.startswith("mammometry."):
                known = vars(module).get(number.variable)
                if not number.variable.startswith("_") and _is_same(known, number.value):
                    _assign(module, number.variable, value)
    return Settings().overridden(overrides)


def _is_same(known: Any, value: Any) -> bool:
    return isinstance(known, type(value)) and known == value


def _assign(module: Any, name: str, value: Any) -> None:
    """Set a module's constant, and update constants derived from it."""
    vars(module)[name] = value
    for statement in ast.parse(Path(module.__file__).read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign) and name in _names_in(statement.value):
            exec(compile(ast.Module([statement], []), module.__file__, "exec"), vars(module))


def _names_in(node: ast.AST) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def readers(number: Number) -> set[str]:
    """Names whose readers depend on a number: its own, and those of constants derived from it."""
    if not number.module:
        return {number.name.rpartition(".")[2]}
    derived = {number.variable}
    for statement in ast.parse(Path(str(sys.modules[number.module].__file__)).read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign) and derived & _names_in(statement.value):
            derived = derived.union(*map(_names_in, statement.targets))
    return derived


def stored_parents(product: Product[Any]) -> set[str]:
    """Names of the stored products that a product depends on, directly or indirectly."""
    parents: set[str] = set()
    for parent in product.made_from:
        parents |= {parent.key.product} if parent.is_stored else stored_parents(parent)
    return parents


@dataclass(slots=True)
class Made:
    """A product of the base."""

    value: Any
    digest: str
    settings: Any
    ran: set[CodeType]
    """Functions that ran while it was made."""


class Base:
    """A capture, measured once with a record of its functions: changed numbers recompute only their products."""

    def __init__(self, opened: Callable[[Settings], Job]) -> None:
        self._opened = opened
        self.made: dict[str, Made] = {}
        self.opening: set[CodeType] = set()
        self._running = [self.opening]
        begun = time.monotonic()
        sys.setprofile(self._note)
        threading.setprofile(self._note)
        products._WORKERS_AT_MOST = 1  # functions are noted for one product at a time
        try:
            self.measured = _measured(self._opened(Settings()), self._make)
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
        self.seconds = time.monotonic() - begun

    def _note(self, frame: FrameType, event: str, argument: Any) -> None:
        if event == "call":
            self._running[-1].add(frame.f_code)

    def _make(self, key: Key, prepare: Callable[[], Callable[[Any], Any]]) -> Any:
        if key.product in self.made:
            return self.made[key.product].value
        ran: set[CodeType] = set()
        self._running.append(ran)
        value = prepare()(lambda fraction: None)
        self._running.pop()
        self.made[key.product] = Made(value, digest_of(value), key.settings, ran)
        return value

    def reached(self, number: Number) -> float:
        """Index of the first product whose functions read the number. −1: opening. Infinite: none."""
        reading = readers(number)
        for place, ran in enumerate([self.opening, *(made.ran for made in self.made.values())], -1):
            if any(_reads(reading, code) for code in ran):
                return place
        return np.inf

    def turned(self, numbers: Sequence[Number], factor: float) -> dict[str, Any]:
        """Measure again with changed numbers."""
        of_modules = set[str]().union(*(readers(one) for one in numbers if one.module))
        of_settings = set[str]().union(*(readers(one) for one in numbers if not one.module))
        changed: set[str] = set()
        job = self._opened(turn(numbers, factor))
        parents = {product.key.product: stored_parents(product) for product in job.plan.products()}
        everything = of_modules | of_settings
        afresh = any(_reads(everything, code) for code in self.opening) and isinstance(self._opened, partial)

        def recall(key: Key, prepare: Callable[[], Callable[[Any], Any]]) -> Any:
            base = self.made.get(key.product)
            if base is not None and key.product not in changed and not afresh:
                reading = everything if key.settings != base.settings else of_modules
                if changed.isdisjoint(parents[key.product]) and not any(_reads(reading, code) for code in base.ran):
                    return base.value
            value = prepare()(lambda fraction: None)
            if base is None or digest_of(value) != base.digest:
                changed.add(key.product)
            self.made[key.product] = Made(value, digest_of(value), key.settings, set())
            return value

        return {**_measured(job, recall), "remade": sorted(changed)}


def _reads(reading: set[str], code: CodeType) -> bool:
    return bool(reading) and not reading.isdisjoint(code.co_names)


def _measured(job: Job, recall: Callable[..., Any]) -> dict[str, Any]:
    """Volumes and intervals of a capture, or its refusal."""
    job.store.recall = recall  # type: ignore[method-assign]  # nothing is stored
    job.store.has = lambda key: False  # type: ignore[method-assign]
    try:
        for product in job.plan.products():
            if product.key.product.split("/")[0] not in _NO_VOLUME:
                product()
                product.release()
        made = job.plan.value(measurements) or ()
        return {"volumes": {one.name: [one.volume_cc, *(one.interval_cc or (0.0, 0.0))] for one in made}}
    except MammometryError as error:
        return {"refused": str(error)}


def digest_of(value: Any) -> str:
    """Digest of a product's value."""
    digest = hashlib.sha256()
    _feed(value, digest)
    return digest.hexdigest()


def _feed(value: Any, digest: Any) -> None:
    if is_dataclass(value):
        for one in fields(value):
            _feed(getattr(value, one.name), digest)
    elif isinstance(value, np.ndarray):
        digest.update(str((value.dtype, value.shape)).encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        for key, part in value.items():
            digest.update(repr(key).encode())
            _feed(part, digest)
    elif isinstance(value, (tuple, list)):
        for part in value:
            _feed(part, digest)
    else:
        digest.update(repr(value).encode())


def opener(name: str, out: Path) -> Callable[[Settings], Job]:
    """Render a capture, unless it is there. Opens it."""
    recipe, place = CAPTURES[name], out / name
    if recipe is not None:
        if not (place / "capture").is_dir():
            write_session(place, recipe)
        return lambda settings: open_session(place, settings)
    mesh = place / "scan.ply"
    if not mesh.exists():
        place.mkdir(parents=True, exist_ok=True)
        made = scan(woman(_WOMAN, "standing"), QUALITIES["telephone"], 0)
        write_ply(mesh, made.mesh, made.ply_colours, comments=())
    files = MeshFiles(mesh=mesh, units="mm", automatic=True)
    return partial(MeshJob, files, place / "results")


def moved_by(row: Mapping[str, Any], base: Mapping[str, Any]) -> float:
    """Largest change of a volume, or of an interval's width, as a share of the width. Infinite: a refusal."""
    if "volumes" not in row or set(row["volumes"]) != set(base["volumes"]):
        return np.inf
    shares = [0.0]
    for name, (volume, low, high) in base["volumes"].items():
        now, now_low, now_high = row["volumes"][name]
        shares += [abs(now - volume) / (high - low), abs((now_high - now_low) / (high - low) - 1)]
    return max(shares)


def _one(base: Base, numbers: Sequence[Number], factor: float, sender: Any) -> None:
    begun = time.monotonic()
    try:
        row = base.turned(numbers, factor)
    except Exception as error:
        row = {"refused": f"{type(error).__name__}: {error}"}
    sender.send({**row, "moved": moved_by(row, base.measured), "seconds": round(time.monotonic() - begun, 2)})


def _write(row: Mapping[str, Any], path: Path) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def rows_in(path: Path) -> dict[tuple[str, str, float], dict[str, Any]]:
    """(capture, name, factor) → row."""
    known = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError):  # cut off
                row = json.loads(line)
                known[row["capture"], row["name"], row["factor"]] = row
    return known


def turn_all(
    name: str, numbers: Sequence[Number], factors: Sequence[float], out: Path, *, together: int, workers: int
) -> None:
    """Change all numbers on one capture that were not changed before."""
    path = out / "rows.jsonl"
    known = rows_in(path)
    left = {factor: [one for one in numbers if (name, one.name, factor) not in known] for factor in factors}
    if not any(left.values()):
        return
    base = Base(opener(name, out))
    turns = sum(map(len, left.values()))
    print(f"{name}: {base.measured} in {base.seconds:.0f} s, {turns} turns", file=sys.stderr)
    if "volumes" not in base.measured:
        raise SystemExit(f"{name} cannot be measured")
    place = {one.name: base.reached(one) for one in numbers}
    waiting: list[tuple[Sequence[Number], float]] = []
    for factor, some in left.items():
        for one in some:
            if place[one.name] == np.inf:
                row = {"capture": name, "name": one.name, "factor": factor, "moved": 0.0, "reached": False}
                _write(row, path)
        # Those that reach the same products first stand together, so that a group makes little anew.
        reached = sorted((one for one in some if place[one.name] < np.inf), key=lambda one: place[one.name])
        waiting += [(reached[at : at + together], factor) for at in range(0, len(reached), together)]
    fork = multiprocessing.get_context("fork")
    running: list[tuple[Any, Any, Sequence[Number], float, float]] = []
    while waiting or running:
        while waiting and len(running) < workers:
            group, factor = waiting.pop(0)
            receiver, sender = fork.Pipe(duplex=False)
            process = fork.Process(target=_one, args=(base, group, factor, sender))
            process.start()
            sender.close()
            running.append((process, receiver, group, factor, time.monotonic()))
        for turned in list(running):
            process, receiver, group, factor, begun = turned
            found = _result(process, receiver, late=time.monotonic() - begun > base.seconds * _SLOW)
            if found is None:
                continue
            running.remove(turned)
            if len(group) > 1 and found["moved"] > MOVED:
                half = len(group) // 2
                waiting = [(group[:half], factor), (group[half:], factor), *waiting]
                continue
            for number in group:
                said = {"capture": name, "name": number.name, "factor": factor, "together": len(group)}
                _write({**said, **found}, path)
        time.sleep(0.02)


def _result(process: Any, receiver: Any, *, late: bool) -> dict[str, Any] | None:
    """Result of a process. None while it runs."""
    if receiver.poll():
        with suppress(EOFError):  # it was killed, for want of memory say
            row: dict[str, Any] = receiver.recv()
            process.join()
            return row
        process.join()
        return {"moved": np.inf, "refused": f"its process ended with {process.exitcode}"}
    if late:
        process.kill()
        process.join()
        return {"moved": np.inf, "refused": "takes too long"}
    return None


def table(rows: Mapping[Any, Mapping[str, Any]], *, everything: bool) -> Iterator[str]:
    """Yield the table of what moves a volume, as Markdown."""
    captures = [name for name in CAPTURES if any(row["capture"] == name for row in rows.values())]
    yield "| number | " + " | ".join(captures) + " |"
    yield "| --- " * (len(captures) + 1) + "|"
    by_name: dict[str, dict[str, list[str]]] = {}
    largest: dict[str, float] = {}
    for row in rows.values():
        largest[row["name"]] = max(largest.get(row["name"], 0.0), row["moved"])
        share = "refused" if row["moved"] == np.inf else f"{100 * row['moved']:.0f}"
        cell = f"{'+' if row['factor'] > 1 else '−'} {share}" if row.get("reached", True) else "·"
        by_name.setdefault(row["name"], {}).setdefault(row["capture"], []).append(cell)
    for name in sorted(by_name, key=lambda one: -largest[one]):
        if everything or largest[name] > MOVED:
            cells = (", ".join(dict.fromkeys(by_name[name].get(capture, ["–"]))) for capture in captures)
            yield f"| `{name}` | " + " | ".join(cells) + " |"
    still = sum(one <= MOVED for one in largest.values())
    never = sum(all(set(cell) == {"·"} for cell in cells.values()) for cells in by_name.values())
    yield ""
    yield f"{still} of {len(largest)} move nothing by more than a tenth; {never} of them are reached on no capture."


def main() -> None:
    """Change the numbers, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("build/sensitivity"))
    parser.add_argument("--captures", nargs="+", choices=list(CAPTURES), default=list(CAPTURES))
    parser.add_argument("--only", nargs="+", help="names of numbers, or what they begin with")
    parser.add_argument("--all-constants", action="store_true", help="also those that were measured")
    parser.add_argument("--turns", nargs="+", type=float, default=list(TURNS))
    parser.add_argument("--together", type=int, default=16, help="numbers that are turned at once, at first")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--table", action="store_true", help="of what is there; turns nothing")
    parser.add_argument("--whole", action="store_true", help="show also what moves nothing")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    numbers = [*all_settings(), *constants(arguments.all_constants)]
    if arguments.only:
        numbers = [one for one in numbers if one.name.startswith(tuple(arguments.only))]
        if not numbers:
            parser.error(f"no number's name begins with {' or '.join(arguments.only)}")
    if not arguments.table:
        cv2.setNumThreads(1)  # a fork has none of its parent's threads, and would wait for them
        for name in arguments.captures:
            turn_all(
                name, numbers, arguments.turns, arguments.out, together=arguments.together, workers=arguments.workers
            )
    print("\n".join(table(rows_in(arguments.out / "rows.jsonl"), everything=arguments.whole)))


if __name__ == "__main__":
    main()
