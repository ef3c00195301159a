"""The products of a session, planned by the method, and the threads that compute them.

Each product knows its key, and is computed or read back when its value is first needed. So one plan runs a job, resumes
it, and knows which results are stale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import groupby
from typing import Any, Self, TypeAlias, TypeVar, overload

from mammometry.base.machine.cores import available_cores
from mammometry.job.inputs import Inputs
from mammometry.job.products import (
    NONE_GIVEN,
    STAGES,
    Context,
    Definition,
    Family,
    Given,
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
    """A thread for products that no later stage needs. With a single core they are computed at once."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1) if available_cores() > 1 else None
        self._begun: list[Future[None]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, where: object) -> None:
        """Wait for products in progress. After an error no other product is started."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=kind is not None)

    def ensure(self, product: Product[Any]) -> None:
        """Compute a product in the background if it is missing."""
        if self._pool is None:
            product.ensure()
        else:
            self._begun.append(self._pool.submit(product.ensure))

    def wait(self) -> None:
        """Wait for all background products. Raises the first error."""
        while self._begun:
            self._begun.pop().result()


Method: TypeAlias = "Callable[[Plan], None]"
"""Function that calls a plan once for each product: `job.method.method`, or a longer one."""


class Plan:
    """All products of a session, not yet computed."""

    def __init__(
        self,
        method: Method,
        inputs: Inputs,
        settings: Settings,
        memo: Memo | None,
        *,
        stages: Sequence[Stage] = STAGES,
        given: Given = NONE_GIVEN,
    ) -> None:
        """Apply the method to a session.

        Args:
            method: calls the plan once for each product, parents first.
            inputs: inputs of the session.
            settings: settings of all stages.
            memo: store of products. None: nothing is stored.
            stages: stages whose products are planned.
            given: replacements of products of the method.
        """
        self.inputs, self.settings = inputs, settings
        self._memo = memo
        self._stages = stages
        self.method, self.given = method, given
        self.bound: dict[Definition[Any], dict[str, Product[Any]]] = {}
        """Definition → item → product. A single product's item is empty."""
        method(self)

    def plans(self, stage: Stage) -> bool:
        """Whether a stage's products are planned. Given products are planned in any case."""
        return stage in self._stages

    def __call__(self, definition: Definition[T], *made: Parents, item: str = "") -> Product[T] | None:
        """Plan a product: one line of the method. Nothing is computed.

        Args:
            definition: the product.
            made: sources of its parameters, in order.
            item: its pose, camera or pair.

        Returns:
            The product. None if its stage is not planned.

        Raises:
            TypeError: the function has other parameters, or the product was entered before.
        """
        instead: Definition[T] = self.given.get(definition, definition)
        if instead is definition and not self.plans(definition.stage):
            return None
        known, name = self.bound.setdefault(definition, {}), instead.function.__name__
        if item in known:
            raise TypeError(f"{name} {item}: entered twice in the method")
        if instead is not definition and not instead.parents:
            made = ()
        if len(made) != len(instead.parents):
            raise TypeError(f"{name}: the method gives {len(made)} products, expected {', '.join(instead.parents)}")
        job = Context(inputs=self.inputs, settings=self.settings, item=item)
        parents = dict(zip(instead.parents, made, strict=True))
        known[item] = product = Product(instead, job, parents, self._memo)
        return product

    @overload
    def __getitem__(self, definition: Single[T]) -> Product[T]: ...

    @overload
    def __getitem__(self, definition: Family[T]) -> Mapping[str, Product[T]]: ...

    def __getitem__(self, definition: Definition[T]) -> Product[T] | Mapping[str, Product[T]]:
        """The product of a definition, or a family's products by item.

        Raises:
            KeyError: the session has no such product.
        """
        products = self.bound.get(definition, {})
        return products if isinstance(definition, Family) else products[""]

    def get(self, definition: Single[T]) -> Product[T] | None:
        """The product. None if the session has no such product."""
        return self.bound.get(definition, {}).get("")

    def value(self, definition: Single[T]) -> T | None:
        """Value of a product, computed or read back. None if the session has no such product."""
        product = self.get(definition)
        return None if product is None else product()

    def current(self, definition: Single[T]) -> T | None:
        """Value of a product that exists already. None if it is missing, or the session has no such product."""
        product = self.get(definition)
        return None if product is None or product.missing else product()

    def products(self, *stages: Stage) -> tuple[Product[Any], ...]:
        """All stored products, or those of some stages, in the order of declaration."""
        return tuple(
            product
            for definition, products in self.bound.items()
            for product in products.values()
            if product.is_stored and definition.stage in (stages or STAGES)
        )

    def ensure(self, stage: Stage, background: Background | None = None) -> None:
        """Compute all missing products of a stage.

        Products that use few threads are computed in parallel, those at the end of the longest path first: each also
        computes its parents, which keeps few values in memory at a time.

        Args:
            stage: the stage.
            background: computes those that no later stage needs, without waiting here.
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
