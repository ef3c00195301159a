"""Products know what they depend on, are made when wanted, once, and leave the memory when they are needed no more."""

import threading
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from planned_sessions import inputs

from mammometry.base.errors import SurfaceError
from mammometry.base.progress import no_progress
from mammometry.job.graph import Background, Plan
from mammometry.job.products import Context, Family, Key, Uncached, at_hand, instead_of, product, product_of_each
from mammometry.settings import Settings


class Results:
    """A memo in memory."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}
        self.made: list[str] = []

    def has(self, key: Key) -> bool:
        return key.digest in self.values

    def recall(self, key: Key, prepare: Any) -> Any:
        if key.digest not in self.values:
            self.values[key.digest] = prepare()(no_progress)
            self.made.append(key.product)
        return self.values[key.digest]


def plan(method: Callable[[Plan], Any], memo: Any = None, settings: Settings = Settings(), **given: Any) -> Plan:
    return Plan(method, inputs("torso"), settings, memo, **given)


def alone(*definitions: Any) -> Callable[[Plan], None]:
    """A method of products that are made from nothing; families have one for each pair."""

    def method(plan: Plan) -> None:
        for definition in definitions:
            for item in plan.inputs.pair_names if isinstance(definition, Family) else ("",):
                plan(definition, item=item)

    return method


def test_a_function_gets_what_the_method_gives_it() -> None:
    """One value, several by name; None where there is none, or its stage is not planned."""

    @product_of_each("match", version=1)
    def photo(*, job: Context) -> str:
        return job.item

    @product_of_each("match", version=1)
    def match(photos: Mapping[str, str], *, job: Context) -> str:
        return f"{job.item} of {'+'.join(photos.values())}"

    @product_of_each("surface", version=1)
    def depth(match: str, *, job: Context) -> str:
        return f"depth {match}"

    @product("surface", version=1)
    def rim(depths: Mapping[str, str], *, job: Context) -> str:
        return "rim"

    @product("surface", version=1)
    def skin(depths: Mapping[str, str], rim: str | None, *, job: Context) -> tuple[Any, ...]:
        return dict(depths), rim

    def method(plan: Plan) -> None:
        cameras, pairs = plan.inputs.photographs, plan.inputs.pair_names
        photos = {camera: plan(photo, item=camera) for camera in cameras}
        matches = {
            pair: plan(match, {camera: photos[camera] for camera in both}, item=pair) for pair, both in pairs.items()
        }
        depths = {pair: plan(depth, matches[pair], item=pair) for pair in pairs}
        plan(skin, depths, plan(rim, depths) if plan.inputs.subject_kind == "model" else None)

    made = plan(method)
    front, floor = "depth front of front_left+front_right", "depth floor of floor_left+floor_right"
    assert made[skin]() == ({"front": front, "floor": floor}, None)
    assert made.get(rim) is None
    assert made.value(rim) is None
    assert list(made[skin].key.inputs) == ["depth/front", "depth/floor"]
    assert made[skin].key.inputs["depth/front"] == made[depth]["front"].key.digest
    later = plan(method, stages=("surface",))
    assert (dict(later[match]), later[depth]["front"].made_from) == ({}, ())


def test_a_method_that_gives_other_than_a_function_takes_is_refused() -> None:
    @product("surface", version=1)
    def skin(depths: object, *, job: Context) -> None: ...

    with pytest.raises(TypeError, match="skin: the method gives 0 products, expected depths"):
        plan(lambda plan: plan(skin))
    with pytest.raises(TypeError, match="skin : entered twice"):
        plan(lambda plan: (plan(skin, None), plan(skin, None)))


@pytest.mark.parametrize(
    "changed",
    [
        {"settings": "surface.repair"},
        {"settings": lambda job: (job.settings.surface.dents,)},
        {"inputs": ("subject",)},
        {"inputs": lambda job: {"rig": "other"}},
        {"version": 2},
        {"name": "other"},
    ],
)
def test_what_it_depends_on_is_in_its_key(changed: dict[str, Any]) -> None:
    def digest(**facts: Any) -> str:
        @product("surface", **({"version": 1, "settings": "surface.dents", "inputs": ("rig",)} | facts))
        def skin(*, job: Context) -> None: ...

        return plan(alone(skin))[skin].key.digest

    assert digest() == digest()
    assert digest(**changed) != digest()


def chain(made: list[str] | None = None) -> tuple[Any, ...]:
    """Disparity (stored, large) → depth (not in keys) → skin, all of the surface."""

    def making(name: str) -> str:
        if made is not None:
            made.append(name)
        return name

    @product("surface", version=1, settings="surface.dents", large=True)
    def disparity(*, job: Context) -> str:
        return making("disparity")

    @product("surface", large=True)
    def depth(disparity: str, *, job: Context) -> str:
        return making("depth")

    @product("surface", version=1)
    def skin(depth: str, *, job: Context) -> str:
        return making("skin")

    def method(plan: Plan) -> None:
        plan(skin, plan(depth, plan(disparity)))

    return method, disparity, depth, skin


def test_a_change_upstream_reaches_all_downstream_through_what_has_no_key() -> None:
    method, disparity, _, skin = chain()
    first, same = plan(method), plan(method)
    other = plan(method, settings=Settings().overridden(["surface.dents.rule=patch"]))
    assert first[skin].key.inputs == {"disparity": first[disparity].key.digest}
    assert first[skin].key.digest == same[skin].key.digest
    assert first[skin].key.digest != other[skin].key.digest


def test_a_value_is_made_once_and_a_remembered_one_not_again() -> None:
    made: list[str] = []
    method, *_, skin = chain(made)
    memo = Results()
    assert plan(method, memo)[skin]() == "skin"
    assert made == ["disparity", "depth", "skin"]
    again = plan(method, memo)
    assert again[skin]() == "skin"
    assert again[skin]() is again[skin]()
    assert made == ["disparity", "depth", "skin"]
    assert memo.made == ["disparity", "skin"], "an intermediate value is not stored"


def and_from(parent: Any, child: Any, method: Callable[[Plan], None]) -> Callable[[Plan], None]:
    """A longer method."""

    def longer(plan: Plan) -> None:
        method(plan)
        plan(child, plan[parent])

    return longer


def in_memory(made: Plan, *definitions: Any) -> list[bool]:
    return [bool(made[definition]._value) for definition in definitions]


def test_a_large_value_is_released_when_the_last_that_needs_it_is_made() -> None:
    method, disparity, depth, skin = chain()

    @product("surface", version=1)
    def rim(disparity: str, *, job: Context) -> str:
        return "rim"

    made = plan(and_from(disparity, rim, method), Results())
    made[skin]()
    assert in_memory(made, disparity, depth, skin) == [True, False, True], "the rim is still to be made of it"
    made[rim]()
    assert in_memory(made, disparity) == [False]
    assert made[disparity].uncached() == "disparity"
    assert in_memory(made, disparity) == [False]
    assert list(Uncached({"front": made[disparity]}).values()) == ["disparity"]


def test_a_large_value_does_not_wait_for_a_later_stage() -> None:
    method, disparity, _, skin = chain()

    @product("measure", version=1)
    def volume(disparity: str, *, job: Context) -> str:
        return "volume"

    made = plan(and_from(disparity, volume, method), Results())
    made.ensure("surface")
    assert in_memory(made, disparity, skin) == [False, True]
    made.ensure("measure")
    assert in_memory(made, disparity) == [False], "it was read back"


def test_only_what_is_missing_is_made() -> None:
    made: list[str] = []
    method, *_, skin = chain(made)
    memo = Results()
    plan(method, memo).ensure("surface")
    del memo.values[plan(method)[skin].key.digest]
    made.clear()
    plan(method, memo).ensure("surface")
    assert made == ["depth", "skin"]
    assert [each.key.product for each in plan(method).products("surface")] == ["disparity", "skin"]
    assert plan(method, memo).current(skin) == "skin"
    assert plan(method).current(skin) is None


def test_a_check_comes_first_and_only_if_something_is_missing() -> None:
    made: list[str] = []
    method, *_ = chain(made)

    @product("surface", version=1, stored=False, check=True)
    def names(*, job: Context) -> None:
        made.append("names")

    def checked(plan: Plan) -> None:
        method(plan)
        plan(names)

    memo = Results()
    plan(checked, memo).ensure("surface")
    plan(checked, memo).ensure("surface")
    assert made == ["names", "disparity", "depth", "skin"]


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> threading.Barrier:
    """A barrier that opens when two products are made at once."""
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    return threading.Barrier(2, timeout=5)


def test_products_of_few_threads_are_made_side_by_side_the_deepest_first(two_cores: threading.Barrier) -> None:
    made: list[str] = []

    @product("surface", version=1, threads=1)
    def short(*, job: Context) -> None:
        made.append("short")

    @product_of_each("surface", version=1, threads=1)
    def depth(*, job: Context) -> int:
        return two_cores.wait()

    @product_of_each("surface", version=1, threads=1)
    def total(depth: int, *, job: Context) -> None:
        made.append(f"total {job.item}")

    @product("surface", version=1)
    def by_itself(*, job: Context) -> None:
        made.append("alone")

    def method(plan: Plan) -> None:
        plan(short)
        depths = {pair: plan(depth, item=pair) for pair in plan.inputs.pair_names}
        for pair in depths:
            plan(total, depths[pair], item=pair)
        plan(by_itself)

    plan(method).ensure("surface")
    assert made[0] in ("total front", "total floor"), "they need both depths at once, and begin before what is short"
    assert (set(made[1:3]) | {made[0], "short"}, made[3:]) == ({"total front", "total floor", "short"}, ["alone"])


def test_the_first_failure_is_told(two_cores: threading.Barrier) -> None:
    @product_of_each("surface", version=1, threads=1)
    def depth(*, job: Context) -> None:
        raise RuntimeError("no depth")

    with pytest.raises(RuntimeError, match="no depth"):
        plan(alone(depth)).ensure("surface")


def test_what_no_later_stage_needs_is_made_in_the_background(two_cores: threading.Barrier) -> None:
    """The model waits for an event that only what comes after the stage sets."""
    later = threading.Event()
    made: list[str] = []

    @product("surface", version=1, threads=1, deferrable=True)
    def model(*, job: Context) -> None:
        assert later.wait(10)
        made.append("model")

    @product("surface", version=1, threads=1)
    def mesh(*, job: Context) -> None:
        made.append("mesh")

    with Background() as background:
        plan(alone(model, mesh)).ensure("surface", background)
        assert made == ["mesh"]
        later.set()
        background.wait()
    assert made == ["mesh", "model"]
    plan(alone(model, mesh)).ensure("surface")  # without a background: all of it at once
    assert sorted(made[2:]) == ["mesh", "model"]


def test_what_fails_in_the_background_is_raised_by_whoever_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    @product("surface", version=1, threads=1, deferrable=True)
    def model(*, job: Context) -> None:
        raise SurfaceError("model", found="no photograph", expected="photographs", remedy="Put them back")

    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    with Background() as background:
        plan(alone(model)).ensure("surface", background)
        with pytest.raises(SurfaceError, match="no photograph"):
            background.wait()
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0})
    with Background() as background, pytest.raises(SurfaceError, match="no photograph"):
        plan(alone(model)).ensure("surface", background)


def test_a_value_at_hand_stands_in_for_a_product() -> None:
    method, disparity, _, skin = chain()
    given = {disparity: at_hand("given", stage="surface", name="mesh", version=3, inputs={"mesh": "1"})}
    made = plan(method, Results(), given=given)
    assert made[disparity]() == "given"
    assert made[skin].key.inputs == {"mesh": made[disparity].key.digest}
    assert [each.key.product for each in made.products()] == ["skin"], "it is no result of ours"


def test_another_function_in_a_line_makes_anew_what_comes_of_it() -> None:
    """It gets what the line gives, has its own name and version in the key, and stands where the other would."""

    @product("surface", version=7, settings="surface.dents")
    def depth(*, job: Context) -> str:
        return "depth"

    @product("surface", version=1)
    def skin(depth: str, *, job: Context) -> str:
        return f"skin of {depth}"

    def method(plan: Plan) -> None:
        plan(skin, plan(depth))

    def told(value: str, version: int = 7) -> Any:
        @instead_of(depth, version=version)
        def deeper(*, job: Context) -> str:
            return value

        return deeper

    def mine(depth: str, *, job: Context) -> str:
        return f"my skin of {depth}"

    memo = Results()
    usual = plan(method, memo)
    other = plan(method, memo, given={depth: told("mine")})
    assert (usual[skin](), other[skin]()) == ("skin of depth", "skin of mine")
    assert other[depth].key.product == usual[depth].key.product, "a page finds it where it always is"
    later = plan(method, memo, given={depth: told("mine", 8)})
    assert len({made[what].key.digest for made in (usual, other, later) for what in (depth, skin)}) == 6
    again = plan(method, memo, given={depth: told("not made anew")})
    assert again[skin]() == "skin of mine"
    changed = plan(method, memo, given={skin: instead_of(skin, version=1)(mine)})
    assert changed[skin]() == "my skin of depth"
    assert changed[depth].key.digest == usual[depth].key.digest
