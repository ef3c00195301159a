"""Products: the values that a run computes, with their keys, storage and release from memory.

A product is declared by a function (`job.stages`) of the values of other products::

    @product_of_each("surface", version=3, settings="surface.triangulate")
    def range_image(disparity: DisparityMap, *, job: Context) -> RangeImage: ...

`job.method` names all these functions, from top to bottom. `graph.Plan` makes a product of each for one session.
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
from mammometry.base.machine.system import return_freed_memory
from mammometry.base.progress import Progress, no_progress
from mammometry.job.inputs import Inputs
from mammometry.settings import Settings, key_table, keyed

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)
Stage: TypeAlias = Literal["calibrate", "match", "surface", "measure", "report"]

_WORKERS_AT_MOST = 4  # each may need half a gigabyte at full image size

STAGES: tuple[Stage, ...] = ("calibrate", "match", "surface", "measure", "report")
"""All stages, in the order in which data flow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """Everything that a product depends on. Equal digests mean equal products."""

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
    """Store of products, kept between runs."""

    def has(self, key: Key) -> bool:
        """Whether the product of `key` is stored."""
        ...

    def recall(self, key: Key, prepare: Callable[[], Callable[[Progress], T]]) -> T:
        """The stored value of `key`. If there is none, `prepare` its inputs, compute and store it."""
        ...


# --- Declarations ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """Inputs, settings and progress, which a product's function gets in addition to other products."""

    inputs: Inputs
    settings: Settings
    """Settings of all stages. A function may read only those that its product declares, as only they are in its key."""
    item: str = ""
    """Pose, camera or pair of this product. Empty: the session has a single one."""
    progress: Progress = no_progress


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Definition(Generic[T_co]):
    """A declared product: the function that computes it, and its metadata."""

    function: Callable[..., T_co]
    stage: Stage
    version: int | None = None
    """Raise it when the result changes for the same inputs and settings. None: an intermediate value, never stored.
    The keys of its children then depend on its parents."""
    name: str
    """Name in keys and on disk, with ``{item}``. The function's name if not given."""
    settings: str | Callable[[Context], object] = ""
    """Its own settings: their path in `Settings`, or a function that returns a dataclass or a tuple of them."""
    inputs: tuple[str, ...] | Callable[[Context], Mapping[str, str]] = ()
    """The session's own inputs in its key: names for `Inputs.key_part`, or a function that returns that part."""
    maker: str = ""
    """Name of the function that replaces the method's own (`instead_of`), for the key."""
    stored: bool = True
    """Whether it is written to disk. False: it is quickly computed from other products."""
    large: bool = False
    """Whether it is freed once the current stage no longer needs it. It is read back when needed."""
    threads: int | None = None
    """Threads that its function uses: several products are computed in parallel. None: all, so it is computed alone."""
    deferrable: bool = False
    """Whether no later stage needs it, so that it may be computed in the background."""
    check: bool = False
    """Whether it only checks a stage's inputs. It runs first, if any product of the stage is missing."""

    @property
    def parents(self) -> tuple[str, ...]:
        """Parameters of the function that get values of products, in order."""
        return tuple(name for name in inspect.signature(self.function).parameters if name != "job")

    def key(self, job: Context, inputs: Mapping[str, str]) -> Key:
        """Key of this product in a session.

        Args:
            job: the session's inputs and settings.
            inputs: name → digest of its parents.
        """
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
    """A product that a session has once."""

    __slots__ = ()


class Family(Definition[T_co]):
    """Products that a session has for each pose, camera or pair."""

    __slots__ = ()


def product(stage: Stage, **facts: Any) -> Callable[[Callable[..., T]], Single[T]]:
    """Decorate a function that computes a product which a session has once.

    Its parameters are the values of the product's parents, in the order in which `job.method` gives them. The last one,
    ``job``, is the `Context`.

    Args:
        stage: stage of the product.
        facts: further fields of `Definition`.
    """

    def declare(function: Callable[..., T]) -> Single[T]:
        return Single(function=function, stage=stage, **({"name": function.__name__} | facts))

    return declare


def product_of_each(stage: Stage, **facts: Any) -> Callable[[Callable[..., T]], Family[T]]:
    """Decorate a function as `product` does, for a product of each pose, camera or pair."""

    def declare(function: Callable[..., T]) -> Family[T]:
        return Family(function=function, stage=stage, **({"name": f"{function.__name__}/{{item}}"} | facts))

    return declare


def instead_of(known: Definition[T], *, version: int, **facts: Any) -> Callable[[Callable[..., T]], Definition[T]]:
    """Decorate a function that replaces that of a product of the method, for `Plan(given=…)`.

    It has the same parameters, and its result is stored in the same place. Its name is in the key, so that all products
    that depend on it are computed again.

    Args:
        known: the product.
        version: raise it when the function's result changes for the same inputs and settings.
        facts: further fields of `Definition`. The others are those of `known`.
    """

    def declare(function: Callable[..., T]) -> Definition[T]:
        return replace(known, function=function, version=version, **({"maker": function.__name__} | facts))

    return declare


Given: TypeAlias = Mapping[Definition[Any], Definition[Any]]
"""Product of the method → its replacement: a value (`at_hand`) or another function (`instead_of`)."""
NONE_GIVEN: Given = MappingProxyType({})


def at_hand(value: T, *, stage: Stage, name: str, version: int | None, inputs: Mapping[str, str]) -> Single[T]:
    """Declare a product whose value is given. It is never written, but is in the keys of its children."""
    return Single(
        function=lambda job: value, stage=stage, version=version, name=name, inputs=lambda job: inputs, stored=False,
    )  # fmt: skip


# --- Products of one session -----------------------------------------------------------------------------------------


class Product(Generic[T]):
    """A value that is computed, or read back, when it is first needed."""

    __slots__ = ("_lock", "_memo", "_value", "children", "definition", "depth", "job", "key", "parents")

    def __init__(self, definition: Definition[T], job: Context, parents: Mapping[str, Parents], memo: Memo | None):
        """Describe a product. Nothing is computed yet.

        Args:
            definition: its declaration.
            job: inputs, settings and item.
            parents: parameter → product, or several by name, or None. Those not planned are left out.
            memo: the store. None: the product is not stored.
        """
        self.definition = definition
        self.job = job
        self.parents = {name: _planned(parent) for name, parent in parents.items()}
        self.children: list[Product[Any]] = []
        self.depth: int = 1 + max((parent.depth for parent in self.made_from), default=0)
        """Number of products on the longest path to it."""
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
        """Whether its value is written to disk."""
        return self.definition.stored and self.definition.version is not None

    @property
    def made_from(self) -> tuple[Product[Any], ...]:
        """All parents of the product."""
        return tuple(_flat(self.parents.values()))

    def __call__(self) -> T:
        """Return the value and keep it in memory until it is released."""
        with self._lock:  # so that two threads do not compute it twice
            if not self._value:
                made = self._memo.recall(self.key, self._prepare) if self._memo else self._prepare()(no_progress)
                self._value.append(made)
            return self._value[0]

    def uncached(self) -> T:
        """Return the value without keeping it in memory."""
        value = self()
        self.release()
        return value

    @property
    def missing(self) -> bool:
        """Whether the product is neither in memory nor stored."""
        return not self._value and not (self._memo is not None and self._memo.has(self.key))

    def ensure(self) -> None:
        """Compute the value if it is missing. A stored value is not read."""
        if self.missing:
            self()
            self._release_if_unneeded(self.key.stage)

    def release(self) -> None:
        """Free the value in memory."""
        with self._lock:
            self._value.clear()

    def _prepare(self) -> Callable[[Progress], T]:
        values = {parameter: _values(parent) for parameter, parent in self.parents.items()}

        def make(progress: Progress) -> T:
            made = self.definition.function(**values, job=replace(self.job, progress=progress))
            values.clear()
            for parent in self.made_from:
                parent._release_if_unneeded(self.key.stage, made=self)
            if self.definition.threads is None:  # nothing else is being computed
                return_freed_memory()
            return made

        return make

    def _release_if_unneeded(self, stage: Stage, made: Product[Any] | None = None) -> None:
        """Free a large value unless this stage needs it for another product."""
        if self.definition.large and not any(
            child._is_to_be_made(stage) for child in self.children if child is not made
        ):
            self.release()

    def _is_to_be_made(self, stage: Stage) -> bool:
        """Whether a stage will still compute it, to store it or for one of its children."""
        if self.key.stage != stage or not self.missing:
            return False
        return self.is_stored or any(child._is_to_be_made(stage) for child in self.children)


Parents: TypeAlias = "Product[Any] | Mapping[str, Product[Any] | None] | None"
"""Source of a parameter's value: one product, several by pose, camera or pair, or none."""


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
    """Value of one parameter of a product's function."""
    if parents is None:
        return None
    if isinstance(parents, Product):
        return parents()
    side_by_side((parent.__call__ for parent in parents.values()), threads=threads_of(parents.values()))
    return {name: parent() for name, parent in parents.items()}


def threads_of(products: Iterable[Product[Any]]) -> int:
    """Largest number of threads that one of them uses."""
    return max((product.definition.threads or available_cores() for product in products), default=1)


def side_by_side(tasks: Iterable[Callable[[], object]], *, threads: int = 1) -> None:
    """Run independent tasks in parallel on all cores. Each task uses `threads` threads itself."""
    with ThreadPoolExecutor(max(1, min(_WORKERS_AT_MOST, available_cores() // threads))) as pool:
        waiting = [pool.submit(task) for task in tasks]
        try:
            for made in as_completed(waiting):
                made.result()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


class Uncached(Mapping[str, T]):
    """Values of products by name, computed or read back at each look-up. They do not stay in memory."""

    def __init__(self, products: Mapping[str, Product[T]]) -> None:
        self._products = products

    def __getitem__(self, name: str) -> T:
        return self._products[name].uncached()

    def __iter__(self) -> Iterator[str]:
        return iter(self._products)

    def __len__(self) -> int:
        return len(self._products)
