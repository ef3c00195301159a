"""Products: what each is made from, its key, its storage, and its release from memory.

A product is a function (`job.stages`) of other products' values::

    @product_of_each("surface", version=3, settings="surface.triangulate")
    def range_image(disparity: DisparityMap, *, job: Context) -> RangeImage: ...

`job.method` calls all such functions, top to bottom. `graph.Plan` makes a product of each call, for one session.
"""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from threading import Lock
from types import MappingProxyType
from typing import Any, Generic, Literal, Protocol, TypeAlias, TypeVar

from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import Progress, no_progress
from mammometry.job.inputs import Inputs
from mammometry.settings import Settings, key_table, keyed

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)
Stage: TypeAlias = Literal["calibrate", "match", "surface", "measure", "report"]

_WORKERS_AT_MOST = 4  # each may hold half a gigabyte at full image size

STAGES: tuple[Stage, ...] = ("calibrate", "match", "surface", "measure", "report")
"""In the order in which data flows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """Digest of all that a product depends on. Equal digests mean equal products."""

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
        """SHA-256 digest of the whole key, hexadecimal."""
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


# --- Declarations ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """Inputs, settings and progress, which the function of a product gets beside other products."""

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
    maker: str = ""
    """Name of the function, in the key, where it is not the one of the method (`instead_of`)."""
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
        """Parameters of the function that get values of products, in their order."""
        return tuple(name for name in inspect.signature(self.function).parameters if name != "job")

    def key(self, job: Context, inputs: Mapping[str, str]) -> Key:
        """Key of this product of a session, made also from `inputs`: name → digest."""
        named, chosen = self.inputs, self.settings
        own = named(job) if callable(named) else job.inputs.key_part(*(name.format(item=job.item) for name in named))
        table = _table(chosen(job)) if callable(chosen) else keyed(job.settings, chosen)
        return Key(
            stage=self.stage,
            product=self.name.format(item=job.item),
            version=self.version or 0,
            settings={**table, "made_by": self.maker} if self.maker else table,
            inputs={**own, **inputs},
        )


def _table(settings: object) -> dict[str, Any]:
    if isinstance(settings, tuple):
        return {type(part).__name__: key_table(part) for part in settings}
    return {} if settings is None else key_table(settings)


class Single(Definition[T_co]):
    """A product of which a session has one."""

    __slots__ = ()


class Family(Definition[T_co]):
    """A product of which a session has one for each pose, camera or pair."""

    __slots__ = ()


def product(stage: Stage, **facts: Any) -> Callable[[Callable[..., T]], Single[T]]:
    """Declare that a function makes a product, of which a session has one.

    Its parameters are values of the products that it is made from: those that `job.method` gives it, in the same order.
    The last parameter, ``job``, is the `Context`.

    Args:
        stage: that it belongs to.
        facts: further fields of `Definition`.
    """

    def declare(function: Callable[..., T]) -> Single[T]:
        return Single(function=function, stage=stage, **({"name": function.__name__} | facts))

    return declare


def product_of_each(stage: Stage, **facts: Any) -> Callable[[Callable[..., T]], Family[T]]:
    """Declare, as `product` does, what makes a product of each pose, camera or pair (`Context.item`)."""

    def declare(function: Callable[..., T]) -> Family[T]:
        return Family(function=function, stage=stage, **({"name": f"{function.__name__}/{{item}}"} | facts))

    return declare


def instead_of(known: Definition[T], *, version: int, **facts: Any) -> Callable[[Callable[..., T]], Definition[T]]:
    """Declare that a function makes a product of the method in another way, for `Plan(given=…)`.

    It takes what the other function takes, and its result lies in the same place. Its name is in the key: what is made
    from it is made anew.

    Args:
        known: the product.
        version: raise it when the function gives another result for the same inputs and settings.
        facts: further fields of `Definition`. Those that are not given are as they are of `known`.
    """

    def declare(function: Callable[..., T]) -> Definition[T]:
        return replace(known, function=function, version=version, **({"maker": function.__name__} | facts))

    return declare


Given: TypeAlias = Mapping[Definition[Any], Definition[Any]]
"""Product of the method → the one instead of it: a value (`at_hand`) or another function (`instead_of`)."""
NONE_GIVEN: Given = MappingProxyType({})


def at_hand(value: T, *, stage: Stage, name: str, version: int | None, inputs: Mapping[str, str]) -> Single[T]:
    """Declare a product whose value is given. It is never written, but part of the keys of its children."""
    return Single(
        function=lambda job: value, stage=stage, version=version, name=name, inputs=lambda job: inputs, stored=False,
    )  # fmt: skip


# --- Products of one session -----------------------------------------------------------------------------------------


class Product(Generic[T]):
    """A value that is made, or read back, when it is first wanted."""

    __slots__ = ("_lock", "_memo", "_value", "children", "definition", "depth", "job", "key", "parents")

    def __init__(self, definition: Definition[T], job: Context, parents: Mapping[str, Parents], memo: Memo | None):
        """Describe a value. Nothing is made yet.

        Args:
            definition: how it is made.
            job: what it is made from beside other products.
            parents: parameter → product, or several by name, or None. Those not planned are left out.
            memo: remembers it. None: nobody does.
        """
        self.definition = definition
        self.job = job
        self.parents = {name: _planned(parent) for name, parent in parents.items()}
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
        """All parents of the product."""
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
        """Whether the product is neither in memory nor remembered."""
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


Parents: TypeAlias = "Product[Any] | Mapping[str, Product[Any] | None] | None"
"""What a parameter gets the value of: one product, several by pose, camera or pair, or none."""


def _planned(parents: Parents) -> Product[Any] | Mapping[str, Product[Any]] | None:
    if not isinstance(parents, Mapping):
        return parents
    return {name: parent for name, parent in parents.items() if parent is not None}


def _flat(parents: Iterable[Product[Any] | Mapping[str, Product[Any]] | None]) -> Iterator[Product[Any]]:
    for parent in parents:
        if isinstance(parent, Product):
            yield parent
        elif parent is not None:
            yield from parent.values()


def _values(parents: Product[Any] | Mapping[str, Product[Any]] | None) -> Any:
    """Value that a function gets for one parameter."""
    if parents is None:
        return None
    if isinstance(parents, Product):
        return parents()
    side_by_side((parent.__call__ for parent in parents.values()), threads=threads_of(parents.values()))
    return {name: parent() for name, parent in parents.items()}


def threads_of(products: Iterable[Product[Any]]) -> int:
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
