"""The graph of a session's products: which there are, and on which threads they are made.

It computes nothing by itself: each product knows its key and is made, or read back, when its value is first needed. So
one plan runs a job, resumes it, and knows what is stale.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import groupby
from types import MappingProxyType
from typing import Any, Self, TypeVar, overload

from mammometry.base.machine.cores import available_cores
from mammometry.job.inputs import Inputs
from mammometry.job.products import (
    DEFINITIONS,
    STAGES,
    Context,
    Definition,
    Family,
    Memo,
    Parents,
    Product,
    Single,
    Stage,
    side_by_side,
    threads_of,
)
from mammometry.settings import Settings

T = TypeVar("T")


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
        """Wait for all background products. Raises what stood in the way of one."""
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
        self.bound: dict[Definition[Any], dict[str, Product[Any]]] = {
            definition: {"": Product(instead, self._job, {}, None)} for definition, instead in given.items()
        }
        """Definition → its products by item, one of no name for a single one. Empty where the session has none."""
        for definition in sorted(DEFINITIONS.values(), key=lambda known: (STAGES.index(known.stage), known.number)):
            self._bind(definition)

    def _bind(self, definition: Definition[Any]) -> dict[str, Product[Any]]:
        """Products of one definition by item. Empty where the session has none."""
        if definition in self.bound:
            return self.bound[definition]
        products: dict[str, Product[Any]] = {}
        if definition.stage in self._stages and definition.when(self._job):
            for item in self._job.inputs.items(definition.item_kind):
                job = replace(self._job, item=item)
                without = definition.without(job)
                parents = {
                    name: None if name in without else self._parents(definition, name, item)
                    for name in definition.parents
                }
                products[item] = Product(definition, job, parents, self._memo)
        self.bound[definition] = products
        return products

    def _parents(self, definition: Definition[Any], name: str, item: str) -> Parents:
        """What a parameter of a product stands for."""
        if name in DEFINITIONS:
            return self._bind(DEFINITIONS[name]).get(item if DEFINITIONS[name].item_kind else "")
        if not name.endswith("s") or (family := DEFINITIONS.get(name[:-1])) is None or family.item_kind is None:
            raise TypeError(f"{definition.function.__name__}: no product is called {name}")
        products = self._bind(family)
        if (definition.item_kind, family.item_kind) == ("pair", "camera"):
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
        products = self.bound[definition]
        return products if definition.item_kind else products[""]

    def get(self, definition: Single[T]) -> Product[T] | None:
        """The product, or None where the session has none."""
        return self.bound[definition].get("")

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
            for definition, products in self.bound.items()
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
            for definition, checks in self.bound.items():
                if definition.check and definition.stage == stage:
                    checks[""].uncached()
        for alone, group in groupby(products, key=lambda product: product.definition.threads is None):
            if alone:
                for product in group:
                    product.ensure()
                continue
            together = sorted(group, key=lambda product: -product.depth)
            if background is not None:
                for product in together:
                    if product.definition.deferrable:
                        background.ensure(product)
                together = [product for product in together if not product.definition.deferrable]
            side_by_side((product.ensure for product in together), threads=threads_of(together))
