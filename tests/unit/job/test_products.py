"""Products know what they depend on and are made when wanted, once."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Barrier
from typing import ClassVar

import pytest

from mammometry.base.errors import SurfaceError
from mammometry.base.progress import Progress
from mammometry.job.beside import Beside
from mammometry.job.graph import VERSIONS, Fleeting, Forgetful, Key, Product, Products, Remade


@dataclass(frozen=True)
class Wide:
    width: float = 1.0


def product(
    name: str = "first", *parents: Product, made: list | None = None, passing: bool = False, **rest: object
) -> Product:
    def function(*, progress: Progress, **values: object) -> object:
        if made is not None:
            made.append(name)
        return (name, *values.values())

    named = {f"p{number}": parent for number, parent in enumerate(parents)}
    return Product(None if passing else Forgetful(), "surface", name, function, parents=named, **rest)  # type: ignore[arg-type]


def test_a_function_receives_its_parents_by_keyword() -> None:
    """One product's value, a dictionary of several products' values, and None where there is no such product."""
    one, front, floor = product("valid"), product("range/front"), product("range/floor")

    def function(
        *, valid: object, ranges: dict[str, object], calibration: object, progress: Progress
    ) -> tuple[object, ...]:
        return valid, ranges, calibration

    parents = {"calibration": None, "ranges": {"front": front, "floor": floor}, "valid": one}
    last = Product(Forgetful(), "surface", "repaired", function, parents=parents)
    assert last() == (("valid",), {"front": ("range/front",), "floor": ("range/floor",)}, None)
    assert last.key.inputs == {each.key.product: each.key.digest for each in (one, front, floor)}


def test_a_value_is_made_once_from_its_parents() -> None:
    made: list[str] = []
    first = product("first", made=made)
    last = product("repaired", first, product("valid", made=made), made=made)
    assert made == []
    assert last() == ("repaired", ("first",), ("valid",))
    assert last() is last()
    assert made == ["first", "valid", "repaired"]
    last.release()
    last()
    assert made == ["first", "valid", "repaired", "repaired"]


def test_parents_that_are_let_go_are_made_anew_where_wanted_again() -> None:
    made: list[str] = []
    kept, large = product("valid", made=made), product("disparity/front", made=made)
    last = product("first", kept, large).letting_go(large)
    assert last() == ("first", ("valid",), ("disparity/front",))
    assert (kept(), large()) == (("valid",), ("disparity/front",))
    assert made == ["valid", "disparity/front", "disparity/front"]


def test_a_passing_value_is_made_once_for_what_needs_it_and_not_kept() -> None:
    """As a photograph is for its foreground and its rectification; whoever takes it depends on what it is made from."""
    made: list[str] = []
    photograph = product("photograph/a", made=made, inputs={"capture/a": "1"}, passing=True)
    foreground = product("foreground/a", photograph, made=made)
    rectified = product("rectified/front", photograph, foreground, made=made, passing=True)
    last = product("disparity/front", rectified, made=made)
    assert foreground.key.inputs == {"capture/a": "1"}
    assert last.key.inputs == {"capture/a": "1", "foreground/a": foreground.key.digest}
    last()
    assert made == ["photograph/a", "foreground/a", "rectified/front", "disparity/front"]
    rectified()
    assert made[4:] == ["photograph/a", "rectified/front"], "both were let go; the foreground was not"


def test_fleeting_values_are_made_anew_each_time() -> None:
    made: list[str] = []
    values = Fleeting({"front": product("disparity/front", made=made)})
    assert list(values) == ["front"]
    assert values["front"] == values["front"]
    assert len(made) == 2


@pytest.mark.parametrize(
    "changed",
    [
        {"settings": Wide(2.0)},
        {"settings": (Wide(),)},
        {"inputs": {"a": "2"}},
        {"inputs": {"b": "1"}},
    ],
)
def test_what_it_depends_on_is_in_its_key(changed: dict[str, object]) -> None:
    same = {"settings": Wide(), "inputs": {"a": "1"}}
    assert product(**same).key.digest == product(**same).key.digest
    assert product(**(same | changed)).key.digest != product(**same).key.digest


def test_a_change_upstream_reaches_all_downstream() -> None:
    def last(width: float) -> Key:
        return product("repaired", product("valid", product("range/front", settings=Wide(width)))).key

    assert last(1.0).digest == last(1.0).digest
    assert last(1.0).digest != last(2.0).digest


def test_versions_cover_what_is_made() -> None:
    with pytest.raises(KeyError):
        product("unheard-of")
    assert min(VERSIONS.values()) >= 1


@dataclass(frozen=True)
class Stage(Products):
    single: Product | None
    many: dict[str, Product]

    side_by_side = (("many",),)


def test_independent_products_are_made_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    meeting = Barrier(2, timeout=5)

    def meet(*, progress: Progress) -> int:
        return meeting.wait()

    two = {name: Product(Forgetful(), "match", f"disparity/{name}", meet) for name in ("front", "floor")}
    Stage(single=None, many=two).ensure()
    assert {each() for each in two.values()} == {0, 1}


@dataclass(frozen=True)
class Grouped(Products):
    first: Product
    short: Product
    last: Product
    long: Product

    side_by_side = (("long", "short"),)


def test_a_group_is_made_at_once_where_its_first_field_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    meeting, made = Barrier(2, timeout=5), []

    def product(name: str, *, meets: bool) -> Product:
        def make(*, progress: Progress) -> None:
            if meets:
                meeting.wait()
            made.append(name)

        return Product(Forgetful(), "match", f"disparity/{name}", make)

    Grouped(
        first=product("first", meets=False), short=product("short", meets=True), last=product("last", meets=False),
        long=product("long", meets=True),
    ).ensure()  # fmt: skip
    assert (made[0], set(made[1:3]), made[3:]) == ("first", {"short", "long"}, ["last"])


def test_the_first_failure_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*, progress: Progress) -> None:
        raise RuntimeError("front")

    stage = Stage(single=None, many={"front": Product(Forgetful(), "match", "disparity/front", fail)})
    with pytest.raises(RuntimeError, match="front"):
        stage.ensure()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Two(Products):
    stored: Product
    derived: Product


def test_what_is_remade_is_no_result_and_still_hands_on_what_it_depends_on() -> None:
    made: list[str] = []

    def take(stored: object, *, progress: Progress) -> object:
        made.append("data")
        return stored

    def plan(width: float) -> Two:
        stored = product("valid", settings=Wide(width), made=made)
        derived = Product(Remade(), "surface", "data", take, parents={"stored": stored})
        return Two(stored=stored, derived=derived)

    two = plan(1.0)
    assert list(two.products()) == [two.stored]
    two.ensure()
    assert made == ["valid"]
    assert two.derived() is two.derived()
    assert made == ["valid", "data"]
    two.release()
    two.derived()
    assert made == ["valid", "data", "valid", "data"], "its value in memory was let go, too"
    assert product("repaired", two.derived).key.digest != product("repaired", plan(2.0).derived).key.digest


def test_what_no_later_stage_needs_is_made_beside_it() -> None:
    """The late product waits for an event that only what comes after the stage sets."""
    made: list[str] = []
    later = threading.Event()

    @dataclass(frozen=True, slots=True, kw_only=True, eq=False)
    class Stage(Products):
        side_by_side: ClassVar[tuple[tuple[str, ...], ...]] = (("model", "mesh"),)
        late: ClassVar[tuple[str, ...]] = ("model",)
        mesh: Product[str]
        model: Product[str]

    def model(*, progress: Progress) -> str:
        assert later.wait(10)
        made.append("model")
        return "model"

    def mesh(*, progress: Progress) -> str:
        made.append("mesh")
        return "mesh"

    stage = Stage(
        mesh=Product(Forgetful(), "surface", "mesh", mesh), model=Product(Forgetful(), "surface", "model", model)
    )
    with ThreadPoolExecutor(1) as pool:
        beside = Beside(pool)
        beside.ensure(stage)
        assert made == ["mesh"]
        later.set()
        beside.wait()
    assert made == ["mesh", "model"]
    stage.release()
    made.clear()
    Beside(None).ensure(stage)  # without a second core: all of it at once
    assert sorted(made) == ["mesh", "model"]


def test_what_fails_beside_is_raised_by_whoever_waits() -> None:
    @dataclass(frozen=True, slots=True, kw_only=True, eq=False)
    class Stage(Products):
        late: ClassVar[tuple[str, ...]] = ("model",)
        model: Product[str]

    def model(*, progress: Progress) -> str:
        raise SurfaceError("model", found="no photograph", expected="photographs", remedy="Put them back")

    with ThreadPoolExecutor(1) as pool:
        beside = Beside(pool)
        beside.ensure(Stage(model=Product(Forgetful(), "surface", "model", model)))
        with pytest.raises(SurfaceError, match="no photograph"):
            beside.wait()
