"""Report stage: keys of its pages. They are folders of files, written by `api`, and not values.

A page's key covers everything that the page shows.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from mammometry.base.identity import Identity
from mammometry.job.graph import Plan
from mammometry.job.products import Key, Product, Stage
from mammometry.job.stages import calibrate
from mammometry.measure.volume.attribution import Attribution
from mammometry.settings import Settings, key_table

VERSIONS: Mapping[str, int] = MappingProxyType({"previews": 10, "content": 11, "report": 22})
"""Kind of page → its version. Raise it when a page changes for the same products."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PageInputs:
    """Everything that a page shows in addition to products."""

    identity: Identity
    """Identity of the subject. All names and dates on the page come from here."""
    settings: Settings
    """Settings of all stages, as listed on the page."""
    stage_seconds: Mapping[str, float] = field(default_factory=dict)
    """Stage → duration of its computation, s."""
    posture: str = ""
    """Posture of the patient. Empty: unknown."""

    def key(self, products: Iterable[Product[Any]], inputs: Mapping[str, str] | None = None) -> Key:
        """Key of a report's content: this, and the products that it shows.

        Args:
            products: all products that the page shows.
            inputs: name → digest of other inputs that it shows.
        """
        made = {f"{product.key.stage}/{product.key.product}": product.key.digest for product in products}
        return Key(
            stage="report",
            product="content",
            version=VERSIONS["content"],
            settings={**key_table(self), "stage_seconds": dict(self.stage_seconds)},
            inputs={**(inputs or {}), **made},
        )


def report_key(content: Key, attributions: Mapping[str, Attribution]) -> Key:
    """Key of a rendered report: its content, and who drew and confirmed the boundaries."""
    inputs = {"report/content": content.digest, "attributions": repr(dict(attributions))}
    return Key(stage="report", product="report", version=VERSIONS["report"], settings={}, inputs=inputs)


def previews_key(stage: Stage, plan: Plan) -> Key:
    """Key of the pictures of a stage: its products and the cameras."""
    shown = [*plan.products(stage), plan[calibrate.cameras]]
    inputs = {product.key.product: product.key.digest for product in shown}
    return Key(stage=stage, product="previews", version=VERSIONS["previews"], settings={}, inputs=inputs)
