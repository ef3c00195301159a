"""docs/session-folder.md lists every field that readers accept and writers write."""

import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from pydantic import BaseModel

from mammometry.calibration.targets.target import TARGETS
from mammometry.capture.loop import record_of
from mammometry.capture.shots import Delivered, Firing
from mammometry.capture.skew import Skew
from mammometry.capture.verdict import CaptureVerdict
from mammometry.io import manifest
from mammometry.io.drift import CameraDrift, DriftEntry, entry_table
from mammometry.io.meshes import merged, scans
from mammometry.io.results.records import ProductRecord


@pytest.fixture(scope="module")
def named(repository: Path) -> set[str]:
    """Words in code type on the page, without the table that they belong to."""
    page = (repository / "docs" / "session-folder.md").read_text(encoding="utf-8")
    spans = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", page, flags=re.DOTALL))
    return {re.sub(r"\[\]", "", part).rpartition(".")[2] for span in spans for part in re.split(r"[ ,=]+", span)}


def manifest_keys() -> Iterator[str]:
    models = [kind for kind in vars(manifest).values() if isinstance(kind, type) and issubclass(kind, BaseModel)]
    tables = {"pairs", "rig", "subject", "target", "intrinsics", "walk", "BaseModel"}
    for model in models:
        yield from set(model.model_fields) - tables


def test_every_key_of_the_manifest_is_on_the_page(named: set[str]) -> None:
    assert set(manifest_keys()) - named == set()
    assert {"region_mm", "rim_radius_mm"} <= set(manifest_keys())


def test_every_key_of_every_target_is_on_the_page(named: set[str]) -> None:
    kinds = [TARGETS[name] for name in ("charuco", "chessboard", "circles", "dotted-cylinder", "points")]
    assert len(kinds) == len(TARGETS)
    keys = {item.name for kind in kinds for item in fields(kind)} | {"edge_mm"}  # type: ignore[arg-type]
    assert {"edge_std_mm", "flatness_mm", "scale_std"} <= keys
    assert keys - named == set()


def test_every_key_of_the_other_files_is_on_the_page(named: set[str]) -> None:
    drift = CameraDrift(moved=False, shift_mm=0.0, turn_deg=0.0, shift_px=0.0, sigma=0.0)
    check = DriftEntry(
        when="", image_set="", calibration="", verdict="", effect_mm=0.0, reasons=(), cameras={"c": drift},
        photographs={"1": "a"},
    )  # fmt: skip
    line = entry_table(check)
    skew = Skew(offset_ms={"c": 0.0}, std_ms=0.0, measured="", exposure_ms=1.0)
    frame = Mock(spec=Delivered, seconds=0.0)
    firing = Firing(fired_s=0.0, frames={"c": frame}, faults={}, seconds=0.0)
    verdict = CaptureVerdict(findings=(), seconds=0.0)
    shot: dict[str, Any] = record_of(firing, verdict, "virtual")
    keys = {
        *line, *line["cameras"]["c"], *skew.as_table(), *ProductRecord.model_fields,
        *scans._KEYS, *merged._KEYS, *shot, *shot["cameras"]["c"], *shot["verdict"],
    }  # fmt: skip
    assert keys - named == set()
