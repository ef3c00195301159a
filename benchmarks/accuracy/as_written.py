"""The paper's method as printed and the default, from photographs to disparities, surface and volume.

    python -m benchmarks.accuracy.as_written --captures ../shared/data/rendered [--subject plaster_a]
    python -m benchmarks.accuracy.as_written --seeds 1 2
    python -m benchmarks.accuracy.as_written --tube ../shared/data/multidic/sample_data

"As printed" is what `mammometry settings --paper` prints. Captures are laid out as ../shared/data/rendered; `--seeds`
simulates a cast for each odd seed and a torso for each even one, so that nothing has to be downloaded; the tube is
MultiDIC's real pair of photographs. Matching is the median over the pairs of their medians and 95th percentiles,
against true disparities; the surface is judged where a pair sees it, unaligned. What is there is not made again.
"""

from __future__ import annotations

import argparse
import json
import runpy
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import mammometry as mm
from benchmarks.accuracy.multidic import ROOT, SETTINGS, fit_cylinder, speckled
from benchmarks.rendered import make_session, subjects
from mammometry.api.truth import evaluate_session
from mammometry.base.errors import MammometryError
from mammometry.settings import paper_method
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio
from mammometry.surface.ranges.range_image import triangulate

METHODS = {"default": mm.Settings(), "as printed": mm.Settings.from_toml(paper_method())}
_TUBE_RADIUS_MM = 57.0  # its nominal one: where the fit starts


def rendered(captures: Path, subject: str, method: str, out: Path) -> dict[str, Any]:
    """Measure one subject of the independent renderer."""
    session = make_session(captures, subject, out / subject / method.replace(" ", "_"))
    return {"subject": subject, "method": method, **figures(session, captures / subject / "truth", method)}


def simulated(seed: int, method: str, out: Path, scale: float) -> dict[str, Any]:
    """Measure one simulated capture; both methods have the same photographs."""
    cast = seed % 2 == 1
    subject = f"plaster_{seed % 9 + 1}" if cast else f"torso_{seed}"
    source, session = (out / f"{seed}-{subject}" / name for name in ("photographs", method.replace(" ", "_")))
    if not (source / "truth").is_dir():
        studio = Studio(skin=make_skin("plaster" if cast else "skin"))
        write_session(source, SessionRecipe(subject=subject, scale=scale, seed=seed), studio)
    session.mkdir(exist_ok=True)
    (session / "session.toml").write_bytes((source / "session.toml").read_bytes())
    for name in ("calibration", "capture"):
        if not (session / name).exists():
            (session / name).symlink_to((source / name).resolve(), target_is_directory=True)
    return {"subject": f"{subject}, seed {seed}", "method": method, **figures(session, source / "truth", method)}


def figures(session: Path, truth: Path, method: str) -> dict[str, Any]:
    """Run a session to its volume, and judge each stage; what was refused is said and left out."""
    job = mm.open_session(session, METHODS[method])
    try:
        job.measure()
        refused = None
    except MammometryError as error:
        refused = str(error)
    found = evaluate_session(job, truth)[0].as_table()
    pairs = [pair for pair in found["matching"].values() if pair is not None]
    row: dict[str, Any] = {"refused": refused}
    row |= {key: float(np.median([pair[key] for pair in pairs])) for key in ("median_px", "p95_px", "complete_percent")}
    if "repaired" in found["surfaces"]:
        surface = found["surfaces"]["repaired"]["unaligned"]
        row |= {f"surface_{key}": surface[key] for key in ("mean_mm", "rms_mm", "p95_mm", "bias_mm")}
        row["surface_complete_percent"] = surface["complete_percent"]
    row["volume_errors_percent"] = {name: volume["error_percent"] for name, volume in found["volumes"].items()}
    return row


def tube(sample_data: Path, method: str, out: Path) -> dict[str, Any]:
    """Measure MultiDIC's tube from its first pair; its truth is that it is a cylinder."""
    folder = out / f"tube_{method.replace(' ', '_')}"
    arguments, sys.argv = sys.argv, ["make_sessions.py", str(sample_data), str(folder)]
    with redirect_stdout(sys.stderr):  # what it says is no row of the table
        runpy.run_path(str(ROOT / "examples" / "multidic" / "make_sessions.py"), run_name="__main__")
    sys.argv = arguments
    job = mm.open_session(folder / "1", METHODS[method].overridden([SETTINGS]))
    rig = job.calibrate().rig
    found = job.match()["front"]
    share, points = speckled(sample_data, rig, triangulate(found))
    fitted = fit_cylinder(points, np.array([0.0, 0.0, 1.0]), _TUBE_RADIUS_MM)
    d_v = found.pair_px * found.d_v_px[found.valid]
    spread = 1.4826 * float(np.median(np.abs(d_v - np.median(d_v))))
    return {
        "method": method,
        "matched_percent": 100 * share,
        "radius_mm": fitted.radius_mm,
        "fit_rms_mm": fitted.rms_mm,
        "kept_percent": 100 * fitted.kept,
        "d_v_median_px": float(np.median(d_v)),
        "d_v_spread_px": spread,
    }


COLUMNS = {
    "subject": ("subject", ""),
    "method": ("method", ""),
    "median_px": ("matching: median px", ".3f"),
    "p95_px": ("95 %", ".3f"),
    "complete_percent": ("complete %", ".1f"),
    "surface_mean_mm": ("surface: mean mm", ".3f"),
    "surface_rms_mm": ("RMS", ".3f"),
    "surface_p95_mm": ("95 %", ".3f"),
    "surface_bias_mm": ("bias", "+.3f"),
    "surface_complete_percent": ("complete %", ".2f"),
    "volume_errors_percent": ("volume error %", ""),
}
TUBE_COLUMNS = {
    "method": ("method", ""),
    "matched_percent": ("tube: matched %", ".1f"),
    "radius_mm": ("radius mm", ".3f"),
    "fit_rms_mm": ("fit RMS mm", ".4f"),
    "kept_percent": ("kept %", ".1f"),
    "d_v_median_px": ("d_V median px", "+.2f"),
    "d_v_spread_px": ("spread px", ".2f"),
}


def show(rows: Iterator[dict[str, Any]], columns: dict[str, tuple[str, str]]) -> list[dict[str, Any]]:
    """Print rows as Markdown, each as soon as it is there; return them."""
    shown = []
    print(
        "| " + " | ".join(title for title, _ in columns.values()) + " |\n" + "| --- " * len(columns) + "|", flush=True
    )
    for row in rows:
        shown.append(row)
        print("| " + " | ".join(_cell(row.get(key), form) for key, (_, form) in columns.items()) + " |", flush=True)
        if row.get("refused"):
            print(f"<!-- {row['subject']}, {row['method']}: {row['refused']} -->", flush=True)
    return shown


def _cell(value: object, form: str) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {percent:+.2f}" for name, percent in value.items()) or "–"
    return "–" if value is None else format(value, form)


def main() -> None:
    """Run both methods on all that is named, print the tables, write them as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--captures", type=Path, help="a folder laid out as ../shared/data/rendered")
    parser.add_argument("--subject", action="append", default=[], help="one subject of it; may be repeated; all")
    parser.add_argument("--seeds", type=int, nargs="*", default=[], help="simulate these captures")
    parser.add_argument("--scale", type=float, default=0.25, help="of the simulated pictures")
    parser.add_argument("--tube", type=Path, help="MultiDIC's sample_data")
    parser.add_argument("--out", type=Path, default=Path("build/as_written"), help="where the sessions lie")
    arguments = parser.parse_args()
    if not (arguments.captures or arguments.seeds or arguments.tube):
        parser.error("nothing to measure: name --captures, --seeds or --tube")
    arguments.out.mkdir(parents=True, exist_ok=True)
    chosen = (arguments.subject or subjects(arguments.captures)) if arguments.captures else []
    rows = [
        *(partial(rendered, arguments.captures, subject, method) for subject in chosen for method in METHODS),
        *(partial(simulated, seed, method, scale=arguments.scale) for seed in arguments.seeds for method in METHODS),
    ]
    record: dict[str, Any] = {}
    if rows:
        record["captures"] = show((row(out=arguments.out) for row in rows), COLUMNS)
    if arguments.tube:
        record["tube"] = show((tube(arguments.tube, method, arguments.out) for method in METHODS), TUBE_COLUMNS)
    (arguments.out / "as_written.json").write_text(json.dumps(record, indent=1))


if __name__ == "__main__":
    main()
