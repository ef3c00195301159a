"""Keys of stored results stay as they are: a session that an earlier version measured is not measured again.

`product_keys.json` was written before products became functions. Of each product it holds the version, the places of
its settings, and its inputs: ``<name>`` is a session's own, ``@stage/product`` another product, and others are as they
stand in the key.
"""

import hashlib
import json
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest
from planned_sessions import Planned, sessions

from mammometry.job.graph import Plan
from mammometry.job.method import method
from mammometry.job.stages import measure, surface
from mammometry.settings import key_table, keyed

STORED: dict[str, dict[str, Any]] = json.loads(Path(__file__).with_name("product_keys.json").read_text())


def settings_table(places: list[str], planned: Planned) -> dict[str, Any]:
    if places == ["surface.extract"]:
        return key_table(planned.settings.surface.extract.of(planned.inputs.subject_kind))
    if len(places) == 1:
        return keyed(planned.settings, places[0])
    return {
        type(value).__name__: key_table(value) for value in (attrgetter(place)(planned.settings) for place in places)
    }


@pytest.mark.parametrize(("name", "planned"), sessions().items())
def test_no_stored_result_becomes_stale(name: str, planned: Planned) -> None:
    """Digests are computed here anew, by what the file says. A raised version is meant to make a result stale."""
    stored = STORED[name]
    plan = Plan(method, planned.inputs, planned.settings, None)
    products = {f"{product.key.stage}/{product.key.product}": product.key for product in plan.products()}
    products["surface/data"] = plan[surface.valid_patches].key
    if (strands := plan.get(surface.strands)) is not None:
        products["surface/strands"] = strands.key
    assert products.keys() == stored.keys()

    @cache
    def digest(product: str) -> str:
        was = stored[product]
        assert products[product].version >= was["version"]
        inputs = {key: digest(value[1:]) if value[0] == "@" else value for key, value in was["inputs"].items()}
        stage, _, kind = product.partition("/")
        members = [stage, kind, products[product].version, settings_table(was["settings"], planned), inputs]
        return hashlib.sha256(json.dumps(members, sort_keys=True).encode()).hexdigest()

    assert {product: key.digest for product, key in products.items()} == {
        product: digest(product) for product in stored
    }


def test_views_bound_the_unseen_skin_of_a_cast_alone() -> None:
    """A patient's hidden fold is closed too far out: that no view leaves it room outwards does not make it known."""
    planned = sessions()
    plans = {name: Plan(method, one.inputs, one.settings, None) for name, one in planned.items()}
    bounded = {name for name, plan in plans.items() if plan.get(measure.views) is not None}
    assert bounded == {name for name, one in planned.items() if one.inputs.subject_kind == "model"} != set()
