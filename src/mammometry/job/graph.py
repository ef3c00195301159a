"""Products and what each is made from: their keys, their storage, when they are made, when they are released.

A product is a function (`job.stages`) whose parameters name the products that it is made from::

    @product("surface", version=3, settings="surface.triangulate", each="pair", threads=1)
    def range_image(disparity: DisparityMap, *, job: Context) -> RangeImage: ...

A `Plan` binds all such functions to one session. It computes nothing: each product knows its key and is made, or read
back, when its value is first needed. So one plan runs a job, resumes it, and knows what is stale.
"""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from itertools import count, groupby
from operator import attrgetter
from threading import Lock
from types import MappingProxyType
from typing import Any, Generic, Literal, Protocol, Self, TypeAlias, TypeVar, overload

from mammometry.base.cores import available_cores
from mammometry.base.progress import Progress, no_progress
from mammometry.base.registry import Registry
from mammometry.job.inputs import Each, Inputs
from mammometry.settings import Settings, as_table

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)
Stage: TypeAlias = Literal["calibrate", "match", "surface", "measure", "report"]

_WORKERS_AT_MOST = 4  # each may hold half a gigabyte at full image size

STAGES: tuple[Stage, ...] = ("calibrate", "match", "surface", "measure", "report")
"""In the order in which data flows."""


# --- What a product depends on, and who remembers it -----------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """What a product depends on. Equal digests mean equal products."""

    stage: Stage
    product: str
    """Kind, or kind/item: ``cameras``, ``disparity/front``."""
    version: int
    settings: Mapping[str, Any]
    """The product's own settings as a plain table."""
    inputs: Mapping[str, str]
    """Name → digest of every input."""

    @property
    def digest(self) -> str:
        """SHA-256 of all of it, hexadecimal."""
        members = [self.stage, self.product, self.version, dict(self.settings), dict(self.inputs)]
        return hashlib.sha256(json.dumps(members, sort_keys=True).encode()).hexdigest()


class Memo(Protocol):
    """Remembers products between runs."""

    def has(self, key: Key) -> bool:
        """Whether the product of `key` is remembered."""
        ...

    def recall(self, key: Key, prepare: Callable[[], Callable[[Progress], T]]) -> T:
        """Return the remembered value of `key`, or make and remember it.

        To make it, `prepare` gathers the inputs first.
        """
        ...


# --- How a product is declared ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """What the function of a product gets beside other products."""

    inputs: Inputs
    settings: Settings
    """Of all stages. A function reads only those that its product declares: they alone are in its key."""
    item: str = ""
    """The pose, camera or pair that this product is of. Empty: the session has one such product."""
    progress: Progress = no_progress


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Definition(Generic[T_co]):
    """A declared product: the function that makes it, and what else is to be known of it."""

    function: Callable[..., T_co]
    stage: Stage
    number: int
    """Place in the order of declaration."""
    each: Each | None
    """What a session has one such product of. None: it has a single one."""
    version: int | None = None
    """Raise it when the result changes for the same inputs and settings. None: an intermediate value, never stored.
    What is made from it depends on what it is made from.
    """
    name: str
    """In keys and on disk, with ``{item}``: the function's name if not given."""
    settings: str | Callable[[Context], object] = ""
    """Its own settings: their place in `Settings`, or a function that gives a dataclass or a tuple of them."""
    inputs: tuple[str, ...] | Callable[[Context], Mapping[str, str]] = ()
    """The session's own inputs in its key: names for `Inputs.key_part`, or a function that gives the part."""
    when: Callable[[Context], bool] = lambda job: True
    """Whether a session has this product. Where it does not, what is made from it gets None."""
    without: Callable[[Context], tuple[str, ...]] = lambda job: ()
    """Parameters that get None, for this pose, camera or pair."""
    stored: bool = True
    """Whether it is written. False: made from others in a moment."""
    large: bool = False
    """Whether it leaves the memory once the stage at work needs it no more. It is read back where it is wanted."""
    threads: int | None = None
    """Threads that its making takes: it is made side by side with others. None: it takes all, and is made alone."""
    deferrable: bool = False
    """Whether no later stage needs it, so that it may be made in the background."""
    check: bool = False
    """Whether it only checks what a stage begins with. It is made before the others, if any of them is missing."""

    @property
    def parents(self) -> tuple[str, ...]:
        """Parameters of the function that name products."""
        return tuple(name for name in inspect.signature(self.function).parameters if name != "job")

    def key(self, job: Context, inputs: Mapping[str, str]) -> Key:
        """Key of this product of a session, made also from `inputs`: name → digest."""
        named, chosen = self.inputs, self.settings
        own = named(job) if callable(named) else job.inputs.key_part(*(name.format(item=job.item) for name in named))
        value = chosen(job) if callable(chosen) else attrgetter(chosen)(job.settings) if chosen else None
        parts = {type(part).__name__: as_table(part) for part in value} if isinstance(value, tuple) else None
        return Key(
            stage=self.stage,
            product=self.name.format(item=job.item),
            version=self.version or 0,
            settings=parts or ({} if value is None else as_table(value)),
            inputs={**own, **inputs},
        )


class Single(Definition[T_co]):
    """A product of which a session has one."""

    __slots__ = ()


class Family(Definition[T_co]):
    """A product of which a session has one for each pose, camera or pair."""

    __slots__ = ()


DEFINITIONS: Registry[Definition[Any]] = Registry(
    "product",
    modules=tuple(f"mammometry.job.stages.{stage}" for stage in ("calibrate", "match", "surface", "measure")),
)
"""All declared products, by the names of their functions."""
_NUMBERS = count()


def product(stage: Stage, **facts: Any) -> Callable[[Callable[..., T]], Single[T]]:
    """Declare that a function makes a product.

    Its parameters name the products that it is made from: ``cameras`` gives one product's value, ``range_images`` the
    values of all ``range_image`` by pair, camera or pose. The last parameter, ``job``, is the `Context`.

    Args:
        stage: that it belongs to.
        facts: further fields of `Definition`.
    """

    def declare(function: Callable[..., T]) -> Single[T]:
        facts.setdefault("name", function.__name__)
        single = Single(function=function, stage=stage, number=next(_NUMBERS), each=None, **facts)
        DEFINITIONS.add(function.__name__)(single)
        return single

    return declare


def product_of_each(each: Each, stage: Stage, **facts: Any) -> Callable[[Callable[..., T]], Family[T]]:
    """Declare that a function makes a product of each pose, camera or pair, as `product` does.

    There ``disparity`` gives the value of the same pair, and ``photographs`` those of a pair's two cameras by name.
    """

    def declare(function: Callable[..., T]) -> Family[T]:
        facts.setdefault("name", f"{function.__name__}/{{item}}")
        family = Family(function=function, stage=stage, number=next(_NUMBERS), each=each, **facts)
        DEFINITIONS.add(function.__name__)(family)
        return family

    return declare


def at_hand(value: T, *, stage: Stage, name: str, version: int | None, inputs: Mapping[str, str]) -> Single[T]:
    """Declare a product whose value is given. It counts in the keys of what is made from it, and is never written."""
    return Single(
        function=lambda job: value, stage=stage, number=0, each=None, version=version, name=name,
        inputs=lambda job: inputs, stored=False,
    )  # fmt: skip


def versions() -> dict[str, int]:
    """Kind of product → version of its making."""
    return {each.name.split("/")[0]: each.version for each in DEFINITIONS.values() if each.version is not None}


# --- Products of one session -----------------------------------------------------------------------------------------


class Product(Generic[T]):
    """A value that is made, or read back, when it is first wanted."""

    __slots__ = ("_lock", "_memo", "_value", "children", "definition", "depth", "job", "key", "parents")

    def __init__(self, definition: Definition[T], job: Context, parents: Mapping[str, Parents], memo: Memo | None):
        """Describe a value. Nothing is made yet.

        Args:
            definition: how it is made.
            job: what it is made from beside other products.
            parents: parameter → product, or several by name, or None.
            memo: remembers it. None: nobody does.
        """
        self.definition = definition
        self.job = job
        self.parents = parents
        self.children: list[Product[Any]] = []
        self.depth: int = 1 + max((parent.depth for parent in self.made_from), default=0)
        """Products on the longest path to it."""
        inputs: dict[str, str] = {}
        for parent in self.made_from:
            parent.children.append(self)
            is_key = parent.definition.version is not None
            inputs |= {parent.key.product: parent.key.digest} if is_key else parent.key.inputs
        self.key: Key = definition.key(job, inputs)
        self._memo = memo if self.is_stored else None
        self._value: list[T] = []
        self._lock = Lock()

    @property
    def is_stored(self) -> bool:
        """Whether its value is written."""
        return self.definition.stored and self.definition.version is not None

    @property
    def made_from(self) -> tuple[Product[Any], ...]:
        """All its parents."""
        return tuple(_flat(self.parents.values()))

    def __call__(self) -> T:
        """Return the value, which then stays in memory until it is released."""
        with self._lock:  # two that need it at once wait for one making of it
            if not self._value:
                made = self._memo.recall(self.key, self._prepare) if self._memo else self._prepare()(no_progress)
                self._value.append(made)
            return self._value[0]

    def uncached(self) -> T:
        """Return the value. It does not stay in memory."""
        value = self()
        self.release()
        return value

    @property
    def missing(self) -> bool:
        """Whether it is neither in memory nor remembered."""
        return not self._value and not (self._memo is not None and self._memo.has(self.key))

    def ensure(self) -> None:
        """Make the value if it is missing. Otherwise it is not loaded."""
        if self.missing:
            self()
            self._release_if_unneeded(self.key.stage)

    def release(self) -> None:
        """Forget the value in memory."""
        with self._lock:
            self._value.clear()

    def _prepare(self) -> Callable[[Progress], T]:
        values = {parameter: _values(parent) for parameter, parent in self.parents.items()}

        def make(progress: Progress) -> T:
            made = self.definition.function(**values, job=replace(self.job, progress=progress))
            values.clear()
            for parent in self.made_from:
                parent._release_if_unneeded(self.key.stage, made=self)
            return made

        return make

    def _release_if_unneeded(self, stage: Stage, made: Product[Any] | None = None) -> None:
        """Release a large value unless this stage makes something else from it."""
        if self.definition.large and not any(
            child._is_to_be_made(stage) for child in self.children if child is not made
        ):
            self.release()

    def _is_to_be_made(self, stage: Stage) -> bool:
        """Whether a stage is still to make it: for itself, or if it is not stored for what is made from it."""
        if self.key.stage != stage or not self.missing:
            return False
        return self.is_stored or any(child._is_to_be_made(stage) for child in self.children)


Parents: TypeAlias = "Product[Any] | Mapping[str, Product[Any]] | None"
"""What a parameter stands for."""


def _flat(parents: Iterable[Parents]) -> Iterator[Product[Any]]:
    for parent in parents:
        if isinstance(parent, Product):
            yield parent
        elif parent is not None:
            yield from parent.values()


def _values(parents: Parents) -> Any:
    """What a function gets of one parameter."""
    if parents is None:
        return None
    if isinstance(parents, Product):
        return parents()
    side_by_side((parent.__call__ for parent in parents.values()), threads=_threads(parents.values()))
    return {name: parent() for name, parent in parents.items()}


def _threads(products: Iterable[Product[Any]]) -> int:
    """Threads that the greediest of them takes."""
    return max((product.definition.threads or available_cores() for product in products), default=1)


def side_by_side(tasks: Iterable[Callable[[], object]], *, threads: int = 1) -> None:
    """Run independent tasks on all cores. Each task itself takes `threads` threads."""
    with ThreadPoolExecutor(max(1, min(_WORKERS_AT_MOST, available_cores() // threads))) as pool:
        waiting = [pool.submit(task) for task in tasks]
        try:
            for made in as_completed(waiting):
                made.result()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


class Uncached(Mapping[str, T]):
    """Values of products by name, made or read back at each look-up. They do not stay in memory."""

    def __init__(self, products: Mapping[str, Product[T]]) -> None:
        self._products = products

    def __getitem__(self, name: str) -> T:
        return self._products[name].uncached()

    def __iter__(self) -> Iterator[str]:
        return iter(self._products)

    def __len__(self) -> int:
        return len(self._products)


# --- The plan --------------------------------------------------------------------------------------------------------


class Background:
    """A thread for products that no later stage needs. With a single core they are made at once."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1) if available_cores() > 1 else None
        self._begun: list[Future[None]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, where: object) -> None:
        """Wait for what was begun. After an error nothing new is begun."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=kind is not None)

    def ensure(self, product: Product[Any]) -> None:
        """Have a product made."""
        if self._pool is None:
            product.ensure()
        else:
            self._begun.append(self._pool.submit(product.ensure))

    def wait(self) -> None:
        """Wait for all of them. Raises what stood in the way of one."""
        while self._begun:
            self._begun.pop().result()


class Plan:
    """Every product of a session, not yet made."""

    def __init__(
        self,
        inputs: Inputs,
        settings: Settings,
        memo: Memo | None,
        *,
        stages: Sequence[Stage] = STAGES,
        given: Mapping[Single[Any], Single[Any]] = MappingProxyType({}),
    ) -> None:
        """Bind the declared products to a session.

        Args:
            inputs: of the session.
            settings: of all stages.
            memo: remembers products between runs. None: nothing is remembered.
            stages: whose products are planned.
            given: declared product → the one instead of it, `at_hand`.
        """
        self._job = Context(inputs=inputs, settings=settings)
        self._memo = memo
        self._stages = stages
        self._bound: dict[Definition[Any], dict[str, Product[Any]]] = {
            definition: {"": Product(instead, self._job, {}, None)} for definition, instead in given.items()
        }
        for definition in sorted(DEFINITIONS.values(), key=lambda each: (STAGES.index(each.stage), each.number)):
            self._bind(definition)

    def _bind(self, definition: Definition[Any]) -> dict[str, Product[Any]]:
        """Products of one definition by item. Empty where the session has none."""
        if definition in self._bound:
            return self._bound[definition]
        products: dict[str, Product[Any]] = {}
        if definition.stage in self._stages and definition.when(self._job):
            for item in self._job.inputs.items(definition.each):
                job = replace(self._job, item=item)
                without = definition.without(job)
                parents = {
                    name: None if name in without else self._parents(definition, name, item)
                    for name in definition.parents
                }
                products[item] = Product(definition, job, parents, self._memo)
        self._bound[definition] = products
        return products

    def _parents(self, definition: Definition[Any], name: str, item: str) -> Parents:
        """What a parameter of a product stands for."""
        if name in DEFINITIONS:
            return self._bind(DEFINITIONS[name]).get(item if DEFINITIONS[name].each else "")
        if not name.endswith("s") or (family := DEFINITIONS.get(name[:-1])) is None or family.each is None:
            raise TypeError(f"{definition.function.__name__}: no product is called {name}")
        products = self._bind(family)
        if (definition.each, family.each) == ("pair", "camera"):
            return {camera: products[camera] for camera in self._job.inputs.pair_names[item] if camera in products}
        return products

    @overload
    def __getitem__(self, definition: Single[T]) -> Product[T]: ...

    @overload
    def __getitem__(self, definition: Family[T]) -> Mapping[str, Product[T]]: ...

    def __getitem__(self, definition: Definition[T]) -> Product[T] | Mapping[str, Product[T]]:
        """The product of a definition, or all of a family by item.

        Raises:
            KeyError: the session has no such product.
        """
        products = self._bound[definition]
        return products if definition.each else products[""]

    def get(self, definition: Single[T]) -> Product[T] | None:
        """The product, or None where the session has none."""
        return self._bound[definition].get("")

    def value(self, definition: Single[T]) -> T | None:
        """Value of a product, made or read back. None where the session has no such product."""
        product = self.get(definition)
        return None if product is None else product()

    def current(self, definition: Single[T]) -> T | None:
        """Value of a product that was made before. None where it is missing, or the session has none."""
        product = self.get(definition)
        return None if product is None or product.missing else product()

    def products(self, *stages: Stage) -> tuple[Product[Any], ...]:
        """All stored products, or those of some stages, in the order of their declaration."""
        return tuple(
            product
            for definition, products in self._bound.items()
            for product in products.values()
            if product.is_stored and definition.stage in (stages or STAGES)
        )

    def ensure(self, stage: Stage, background: Background | None = None) -> None:
        """Make all products of a stage that are missing.

        Products that take few threads are made side by side, those at the end of a path first: each makes what it is
        made from, so that little is in memory at a time.

        Args:
            stage: whose products.
            background: makes those that no later stage needs, for which nobody waits here.
        """
        products = self.products(stage)
        if any(product.missing for product in products):
            for definition, checks in self._bound.items():
                if definition.check and definition.stage == stage:
                    checks[""]()
        for alone, group in groupby(products, key=lambda each: each.definition.threads is None):
            if alone:
                for product in group:
                    product.ensure()
                continue
            together = sorted(group, key=lambda each: -each.depth)
            if background is not None:
                for product in together:
                    if product.definition.deferrable:
                        background.ensure(product)
                together = [product for product in together if not product.definition.deferrable]
            side_by_side((product.ensure for product in together), threads=_threads(together))
