"""Nine virtual plaster casts, flat and curved backs, from photographs to volume, against their exact volumes.

    python -m benchmarks.accuracy.simulated_casts --out build/casts

Each cast has a rig of its own (seed 20 + its number) at a quarter of the reference size. Resumes: what is there is not
made again. Prints one row a cast and the mean and standard deviation of the errors.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from pathlib import Path

_FIRST_SEED = 20


def command_line(*arguments: str) -> str:
    """Run `mammometry` in a process of its own; return what it prints."""
    done = subprocess.run([sys.executable, "-m", "mammometry", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"mammometry {' '.join(arguments)}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout


def main() -> None:
    """Simulate and measure every cast, print the table, write it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("build/casts"))
    parser.add_argument("--scale", type=float, default=0.25, help="of the reference cameras' 4504 × 3000 pixels")
    arguments = parser.parse_args()
    rows = []
    print("| cast | true cc | measured cc | error cc | error % | 95 % interval cc | holds |\n" + "| --- " * 7 + "|")
    for number in range(1, 10):
        name = f"plaster_{number}"
        session = arguments.out / name
        if not (session / "session.toml").is_file():
            seed = str(_FIRST_SEED + number)
            command_line("simulate", str(session), "--subject", name, "--seed", seed, "--scale", str(arguments.scale))
        result = json.loads(command_line("measure", str(session), "--json"))
        true_cc = json.loads((session / "truth" / "truth.json").read_text())["volume_cc"]
        measured_cc = result["volumes_cc"]["model"]
        low, high = result["intervals_cc"]["model"]
        rows.append({"cast": name, "true_cc": true_cc, "measured_cc": measured_cc, "interval_cc": [low, high]})
        holds = "yes" if low <= true_cc <= high else "no"
        print(
            f"| {name} | {true_cc:.1f} | {measured_cc:.1f} | {measured_cc - true_cc:+.2f} | "
            f"{100 * (measured_cc / true_cc - 1):+.2f} | {low:.1f} … {high:.1f} | {holds} |",
            flush=True,
        )
    errors = [row["measured_cc"] - row["true_cc"] for row in rows]
    print(f"\nmean {statistics.mean(errors):+.2f} cc, standard deviation {statistics.stdev(errors):.2f} cc")
    (arguments.out / "simulated_casts.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
