"""Values with known dependencies, made or recalled when first needed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from threading import Lock
from types import MappingProxyType
from typing import Any, ClassVar, Generic, Literal, Protocol, Self, TypeAlias, TypeVar

from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import Progress
from mammometry.base.registry import Registry
from mammometry.settings import as_table

T = TypeVar("T")
Parent: TypeAlias = "Product[Any] | Mapping[str, Product[Any]] | None"
"""Parent of a product: another product, several by name, or None."""
Stage: TypeAlias = Literal["calibrate", "match", "surface", "measure", "report"]

_WORKERS_AT_MOST = 4  # each may hold half a gigabyte at full image size
_PARENTS_AT_ONCE = 2  # the left picture's and the right one's

STAGES: tuple[Stage, ...] = ("calibrate", "match", "surface", "measure", "report")
"""In the order in which data flows."""

VERSIONS: Registry[int] = Registry(
    "kind of product",
    entries={
        "observations": 8,
        "calibration": 6,
        "cameras": 6,
        "names": 1,
        "subjects": 1,
        "foreground": 13,
        "disparity": 16,
        "rows": 1,
        "range": 3,
        "stillness": 4,
        "stood": 2,
        "valid": 5,
        "data": 1,
        "blocked": 6,
        "first": 10,
        "repaired": 5,
        "mesh": 4,
        "model": 6,
        "absent": 3,
        "sides": 9,
        "boundaries": 15,
        "body": 4,
        "measurement": 17,
        "lacking": 4,
        "landmarks": 4,
        "symmetry": 3,
        "dimensions": 5,
        "previews": 10,
        "content": 3,
        "report": 15,
    },
)
"""Kind of product → version of its making. Raise it when the result changes for the same inputs and settings."""


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


class Forgetful:
    """A memo that keeps nothing: every product is made again."""

    def has(self, key: Key) -> bool:
        """Say no."""
        return False

    def recall(self, key: Key, prepare: Callable[[], Callable[[Progress], T]]) -> T:
        """Make the product."""
        return prepare()(lambda fraction: None)


class Remade(Forgetful):
    """The memo of a product that is never stored. It is made from others in a moment."""


class Product(Generic[T]):
    """A value that is made, or recalled, when it is first wanted."""

    __slots__ = ("_function", "_let_go", "_lock", "_memo", "_parents", "_value", "key", "passing", "remade")

    def __init__(
        self,
        memo: Memo | None,
        stage: Stage,
        name: str,
        function: Callable[..., T],
        *,
        parents: Mapping[str, Parent] = MappingProxyType({}),
        settings: object = None,
        inputs: Mapping[str, str] | None = None,
    ) -> None:
        """Describe a value. Nothing is made yet.

        Args:
            memo: remembers the value between runs. None: a passing value, between others, never remembered and let
                go once something is made of it. Whoever takes it depends on what it is made from. Its parents are
                made side by side.
            stage: that it belongs to.
            name: kind, or kind/item: ``disparity/front``.
            function: makes it. It is called with the parents' values and ``progress``, all by keyword.
            parents: keyword → what the function gets under it: a product's value, or a dictionary of values where
                several products are given by name, or None.
            settings: its own settings, one dataclass or a tuple of them.
            inputs: name → digest of what it is made from beside parents and settings.
        """
        products = tuple(_products(parents))
        taken = dict(inputs or {})
        for parent in products:
            taken |= parent.key.inputs if parent.passing else {parent.key.product: parent.key.digest}
        self.key: Key = Key(
            stage=stage,
            product=name,
            version=0 if memo is None else VERSIONS[name.split("/")[0]],
            settings=_table(settings),
            inputs=taken,
        )
        self.passing: bool = memo is None
        self.remade: bool = isinstance(memo, Remade)
        self._memo: Memo = memo or Forgetful()
        self._function = function
        self._parents = parents
        self._let_go = tuple(parent for parent in products if parent.passing)
        self._value: list[T] = []
        self._lock = Lock()

    def letting_go(self, *parents: Product[Any]) -> Self:
        """Release parents once this is made from them. They are large and rarely wanted again."""
        self._let_go = (*parents, *self._let_go)
        return self

    def __call__(self) -> T:
        """Return the value. It stays in memory until `release`."""
        with self._lock:  # two that need it at once wait for one making of it
            if not self._value:
                self._value.append(self._memo.recall(self.key, self._prepare))
            return self._value[0]

    @property
    def missing(self) -> bool:
        """Whether the memo lacks the value."""
        return not self._value and not self._memo.has(self.key)

    def ensure(self) -> None:
        """Make the value if the memo lacks it, without loading it otherwise."""
        if self.missing:
            self()

    def release(self) -> None:
        """Forget the value in memory. The memo still has it."""
        with self._lock:
            self._value.clear()

    def _prepare(self) -> Callable[[Progress], T]:
        products = tuple(dict.fromkeys(_products(self._parents)))
        if self.passing:
            with ThreadPoolExecutor(_PARENTS_AT_ONCE) as pool:
                values = dict(zip(products, pool.map(lambda parent: parent(), products), strict=True))
        else:
            values = {parent: parent() for parent in products}
        named = {keyword: _values(parent, values) for keyword, parent in self._parents.items()}
        values.clear()

        def make(progress: Progress) -> T:
            made = self._function(**named, progress=progress)
            named.clear()
            for parent in self._let_go:
                parent.release()
            return made

        return make


def _products(parents: Mapping[str, Parent]) -> Iterator[Product[Any]]:
    """All products among the parents, in their given order."""
    for parent in parents.values():
        if isinstance(parent, Product):
            yield parent
        elif parent is not None:
            yield from parent.values()


def _values(parent: Parent, values: Mapping[Product[Any], Any]) -> Any:
    """What the function gets of one parent."""
    if parent is None:
        return None
    if isinstance(parent, Product):
        return values[parent]
    return {name: values[product] for name, product in parent.items()}


def fleeting(product: Product[T]) -> T:
    """A product's value, made or recalled. It is not kept."""
    value = product()
    product.release()
    return value


class Fleeting(Mapping[str, T]):
    """Values of products by name, made or recalled at each look-up. They are not kept."""

    def __init__(self, products: Mapping[str, Product[T]]) -> None:
        self._products = products

    def __getitem__(self, name: str) -> T:
        return fleeting(self._products[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._products)

    def __len__(self) -> int:
        return len(self._products)


def _table(settings: object) -> dict[str, Any]:
    if settings is None:
        return {}
    if isinstance(settings, tuple):
        return {type(part).__name__: as_table(part) for part in settings}
    return as_table(settings)


def side_by_side(tasks: Iterable[Callable[[], None]], *, threads: int = 1) -> None:
    """Run independent tasks on all cores. Each task itself takes `threads` threads."""
    with ThreadPoolExecutor(max(1, min(_WORKERS_AT_MOST, available_cores() // threads))) as pool:
        waiting = [pool.submit(task) for task in tasks]
        try:
            for made in as_completed(waiting):
                made.result()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


class Products:
    """Base of all stages' plans: their products in the order of making."""

    __slots__ = ()

    side_by_side: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Groups of fields whose products are made at once, what takes longest first. Others are made in order."""
    late: ClassVar[tuple[str, ...]] = ()
    """Fields that no later stage needs: they may be made beside the next one."""

    def products(self) -> Iterator[Product[Any]]:
        """All products of this stage."""
        for name in self.__dataclass_fields__:  # type: ignore[attr-defined]  # only dataclasses derive from this
            yield from self._of(name)

    def _of(self, name: str) -> Iterator[Product[Any]]:
        """The products of one field, except those that are remade or passing."""
        return (product for product in self._made_or_remade(name) if not (product.remade or product.passing))

    def _made_or_remade(self, name: str) -> Iterator[Product[Any]]:
        """All products of one field."""
        value = getattr(self, name)
        if isinstance(value, Product):
            yield value
        elif isinstance(value, Mapping):
            yield from value.values()

    def ensure(self, beside: Executor | None = None) -> list[Future[None]]:
        """Make all products that the memo lacks.

        Args:
            beside: makes the late ones, for which nobody waits here. None: they are made as the others.

        Returns:
            What is being made beside.
        """
        groups = {name: group for group in self.side_by_side for name in group}
        late = self.late if beside is not None else ()
        begun: list[Future[None]] = []
        done: set[str] = set()
        for name in self.__dataclass_fields__:  # type: ignore[attr-defined]  # only dataclasses derive from this
            if name in done:
                continue
            group = groups.get(name, (name,))
            if beside is not None:
                begun += [beside.submit(each.ensure) for member in group if member in late for each in self._of(member)]
            products = [product for member in group if member not in late for product in self._of(member)]
            if name in groups:
                side_by_side(product.ensure for product in products)
            else:
                for product in products:
                    product.ensure()
            done.update(group)
        return begun

    def release(self) -> None:
        """Forget all values in memory."""
        for name in self.__dataclass_fields__:  # type: ignore[attr-defined]  # only dataclasses derive from this
            for product in self._made_or_remade(name):
                product.release()
