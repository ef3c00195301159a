"""Changes of a session's files and settings since its results were made."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mammometry.io.results.records import ProductRecord
from mammometry.io.results.store import Store
from mammometry.job.graph import Plan
from mammometry.job.inputs import MISSING
from mammometry.job.products import STAGES, Key
from mammometry.settings import Settings, names

FILES: Mapping[str, str] = {
    "rig": "rig.pairs in session.toml",
    "mounting": "rig.mounting in session.toml",
    "rim": "subject.rim_radius_mm in session.toml",
    "subject": "subject.kind in session.toml",
    "target": "[target] in session.toml",
    "intrinsics-target": "[intrinsics] in session.toml",
    "attributions": "who drew or confirmed a boundary",
    "boundaries": "boundaries.json",
    "landmarks": "landmarks.json",
    "cameras": "cameras.json",
    "prior": "prior.json",
    "wall": "wall.ply",
    "mesh": "the mesh, its unit or its axes",
    "scale": "the uncertainty of the scale",
}
"""Name of an input in keys → its place. Photographs, masks and tables have their paths."""
_LENS = "intrinsics-"  # prefix of the camera in the name of lens photographs
_OF_PAGES = {"identity.name": "the folder's name", "identity.subject": "subject.id", "identity.date": "date"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """Differences between the sources of stored results and the present ones."""

    inputs: tuple[str, ...] = ()
    """Files and parts of the manifest that have changed since the results were made."""
    absent: tuple[str, ...] = ()
    """Photographs of the results that are missing."""
    settings: tuple[str, ...] = ()
    """Dotted names of changed settings, and other changed content of a page: the folder's name, the date."""
    subject: bool = False
    """Whether the subject's identifier differs."""
    software: bool = False
    """Whether a different version of mammometry made them."""

    @property
    def words(self) -> tuple[str, ...]:
        """Each difference as text. Empty: only an earlier result differs."""
        return (
            *self.inputs,
            *(f"{name} is missing" for name in self.absent),
            *(f"setting {name}" if "." in name else name for name in self.settings),
            *(["subject.id"] if self.subject else []),
            *(["the version of mammometry"] if self.software else []),
        )


def changes(store: Store, plan: Plan, keys: Iterable[Key]) -> Changes:
    """Differences between the keys of results and their records. Results without a record are ignored.

    Args:
        store: the store with the records.
        plan: plan of the session or scan, to distinguish its files from its results.
        keys: keys of the results that would be made now.
    """
    made = [product.key for products in plan.bound.values() for product in products.values()]
    results = {key.product for key in made}
    digests = {key.digest for key in made}
    inputs, absent, settings = dict[str, None](), dict[str, None](), dict[str, None]()
    subject = software = False
    for key in keys:
        record = store.record(key)
        if record is None:
            continue
        subject |= record.subject != store.subject
        software |= record.version != key.version
        for name in _differing(record, key):
            now = key.inputs.get(name)
            of_page = key.stage == "report" and name.partition("/")[0] in STAGES
            if now in digests or (now is None and name in results) or of_page:
                continue
            source = source_of(key, name)
            (absent if now == MISSING else inputs)[FILES.get(source, source)] = None
        stored, wanted = dict(_flat(record.settings)), dict(_flat(json.loads(json.dumps(dict(key.settings)))))
        group = _group(plan, key)
        for name in {**stored, **wanted}:
            if stored.get(name) != wanted.get(name) and not name.startswith("stage_seconds."):
                settings[_OF_PAGES.get(name) or _full_name(group, name.removeprefix("settings."))] = None
    return Changes(
        inputs=tuple(inputs), absent=tuple(absent), settings=tuple(settings), subject=subject, software=software
    )


def source_of(key: Key, name: str) -> str:
    """Name in `Inputs.digests` of an input of a key.

    Products of target detections name their photographs without the folder.
    """
    kind, _, item = key.product.partition("/")
    if kind != "observations" or name.startswith("points/"):
        return name
    if item.startswith(_LENS):
        return "intrinsics-target" if name == "target" else f"intrinsics/{item.removeprefix(_LENS)}/{name}"
    return name if name == "target" else f"calibration/{name}"


def _differing(record: ProductRecord, key: Key) -> list[str]:
    return [name for name in {**record.inputs, **key.inputs} if record.inputs.get(name) != key.inputs.get(name)]


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _group(plan: Plan, key: Key) -> str:
    """Group of the settings that a product declares. Empty if it declares none or chooses them itself."""
    for definition, products in plan.bound.items():
        if isinstance(definition.settings, str) and any(product.key == key for product in products.values()):
            return definition.settings
    return ""


def _full_name(group: str, name: str) -> str:
    """Dotted name of a setting, of which a key may contain only the end."""
    known = names(Settings())
    whole = f"{group}.{name}" if group else name
    ends = [full for full in known if full.endswith(f".{name.rpartition('.')[2]}")]
    return ends[0] if whole not in known and len(ends) == 1 else whole
