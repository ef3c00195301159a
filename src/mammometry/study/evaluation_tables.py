"""An evaluation as tables, one per stage."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mammometry.study.evaluation import Evaluation
from mammometry.study.tables import TextTable, number

_Column = tuple[str, Callable[[Any], str]]


def evaluation_tables(found: Evaluation) -> list[TextTable]:
    """One table per stage with results."""
    pair, worst_mm = found.cameras.worst_pair
    rig = found.cameras
    tables = [
        TextTable(
            title="Calibration: cameras after rigid alignment over the working volume",
            columns=("camera", "projection px", "centre mm", "focal %"),
            rows=(
                *(
                    (
                        name,
                        number(camera.projection_rms_px),
                        number(camera.centre_mm),
                        number(camera.focal_percent, "+.4f"),
                    )
                    for name, camera in rig.cameras.items()
                ),
                (
                    "all, RMS (focal: worst)",
                    number(rig.projection_rms_px),
                    number(rig.centre_rms_mm),
                    number(rig.focal_worst_percent, "+.4f"),
                ),
            ),
        ),
        TextTable(
            title=f"Calibration: triangulation, worst pair {pair} {number(worst_mm)} mm",
            columns=("pair", "RMS mm"),
            rows=tuple((name, number(value)) for name, value in rig.triangulation_rms_mm.items()),
        ),
        _table(
            "Silhouettes: distance from the true outline, positive outside",
            "camera",
            found.silhouettes,
            ("mean px", lambda silhouette: number(silhouette.mean_px, "+.2f")),
            ("95 % px", lambda silhouette: number(silhouette.p95_px, ".2f")),
        ),
        _table(
            "Matching: disparity error where both cameras see the surface, 5 px off its edges, below 70°",
            "pair",
            found.matching,
            ("median px", lambda matching: number(matching.median_px)),
            ("95 % px", lambda matching: number(matching.p95_px)),
            ("> 1 px %", lambda matching: number(matching.beyond_1_px_percent, ".2f")),
            ("complete %", lambda matching: number(matching.complete_percent, ".1f")),
            ("bias mm", lambda matching: number(matching.depth_bias_mm, "+.3f")),
            ("error / σ", lambda matching: number(matching.error_over_sigma, ".2f")),
            ("d_V px", lambda matching: number(matching.d_v_median_px, "+.3f")),
        ),
        _table(
            "Range images: measured minus true distance, with the cameras' errors",
            "pair",
            found.ranges,
            ("bias mm", lambda ranges: number(ranges.bias_mm, "+.3f")),
            ("median mm", lambda ranges: number(ranges.median_mm)),
            ("95 % mm", lambda ranges: number(ranges.p95_mm)),
        ),
        TextTable(
            title="Surface: mm, where at least one pair sees the skin; positive outside",
            columns=("surface", "mean", "median", "RMS", "95 %", "bias", "complete %", "claimed %", "stray %"),
            rows=tuple(
                (
                    how or name,
                    *(
                        number(value)
                        for value in (accuracy.mean_mm, accuracy.median_mm, accuracy.rms_mm, accuracy.p95_mm)
                    ),
                    number(accuracy.bias_mm, "+.3f"),
                    number(accuracy.complete_percent, ".2f"),
                    number(accuracy.claimed_percent, ".2f") if accuracy is judged.claimed else "",
                    number(judged.stray_percent, ".2f") if accuracy is judged.unaligned else "",
                )
                for name, judged in found.surfaces.items()
                for how, accuracy in (
                    ("", judged.unaligned),
                    ("… claimed", judged.claimed),
                    ("… by ICP", judged.aligned),
                )
                if accuracy is not None
            ),
        ),
        _table(
            "Boundary: distance from the true curve; height towards the front",
            "breast",
            found.boundaries,
            ("mean mm", lambda boundary: number(boundary.mean_mm, ".2f")),
            ("95 % mm", lambda boundary: number(boundary.p95_mm, ".2f")),
            ("worst mm", lambda boundary: number(boundary.worst_mm, ".2f")),
            ("height mm", lambda boundary: number(boundary.height_bias_mm, "+.3f")),
        ),
        TextTable(
            title="Volume",
            columns=("breast", "true cc", "measured cc", "error cc", "error %", "95 % interval cc", "holds the truth"),
            rows=tuple(
                (
                    name,
                    number(volume.true_cc, ".1f"),
                    number(volume.measured_cc, ".1f"),
                    number(volume.error_cc, "+.2f"),
                    number(volume.error_percent, "+.2f"),
                    _interval(found.intervals_cc[name]),
                    {True: "yes", False: "no", None: "–"}[volume.covered],
                )
                for name, volume in found.volumes.items()
            ),
        ),
    ]
    return [table for table in tables if table.rows]


def _table(title: str, first: str, values: Mapping[str, Any], *columns: _Column) -> TextTable:
    return TextTable(
        title=title,
        columns=(first, *(name for name, _ in columns)),
        rows=tuple(
            (name, *("–" if value is None else show(value) for _, show in columns)) for name, value in values.items()
        ),
    )


def _interval(interval: tuple[float, float] | None) -> str:
    return "–" if interval is None else f"{number(interval[0], '.1f')} … {number(interval[1], '.1f')}"
