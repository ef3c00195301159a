"""The whole job on the independent renderer's captures, against their truth.

    python -m benchmarks.accuracy.whole_job ../shared/data/rendered --out build/whole_job

Prints one row a breast (true and measured volume, error, interval) as Markdown; the JSON has time and memory, too.
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.rendered import make_session, read_truth, subjects


def measure(captures: Path, subject: str, out: Path) -> list[dict[str, Any]]:
    """Run the command line's main job on one subject, in a process of its own, and compare."""
    session = make_session(captures, subject, out / subject)
    command = [sys.executable, "-m", "mammometry", "run", str(session), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{subject}: exit code {done.returncode}: {done.stderr.strip() or done.stdout.strip()}")
    result = json.loads(done.stdout)
    rows = []
    for name, true_cc in read_truth(captures, subject).volumes_cc.items():
        measured_cc = result["volumes_cc"].get(name, math.nan)  # a side that was refused has none
        interval = result["intervals_cc"].get(name)
        rows.append(
            {
                "subject": subject,
                "name": name,
                "true_cc": true_cc,
                "measured_cc": measured_cc,
                "error_cc": measured_cc - true_cc,
                "error_percent": 100 * (measured_cc / true_cc - 1),
                "interval_cc": interval,
                "inside": None if interval is None else interval[0] <= true_cc <= interval[1],
                "watertight": result["watertight"],
                "seconds": result["seconds"],
                "stage_seconds": result["stage_seconds"],
                "peak_memory_mb": result["peak_memory_mb"],
            }
        )
    return rows


def as_markdown(rows: list[dict[str, Any]]) -> str:
    """The table that docs/measured.md shows."""
    lines = [
        "| subject | breast | true cc | measured cc | error cc | error % | 95 % interval cc |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        interval = "none" if row["interval_cc"] is None else "{:.1f} … {:.1f}".format(*row["interval_cc"])
        lines.append(
            f"| {row['subject']} | {row['name']} | {row['true_cc']:.1f} | {row['measured_cc']:.1f} | "
            f"{row['error_cc']:+.1f} | {row['error_percent']:+.2f} | {interval} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Parse the arguments, run every subject, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path, help="folder laid out as ../shared/data/rendered")
    parser.add_argument("--out", type=Path, default=Path("build/whole_job"), help="where the sessions are made")
    parser.add_argument("--subjects", nargs="*", help="only these")
    arguments = parser.parse_args()
    rows = []
    for subject in arguments.subjects or subjects(arguments.captures):
        rows += measure(arguments.captures, subject, arguments.out)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    record = {"commit": commit.stdout.strip(), "machine": platform.processor() or platform.machine(), "rows": rows}
    (arguments.out / "whole_job.json").write_text(json.dumps(record, indent=1))
    print(as_markdown(rows))


if __name__ == "__main__":
    main()
