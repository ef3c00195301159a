"""Draw the paper's figures from a session, and lay its Table 1 beside nine virtual casts.

    python -m benchmarks.paper SESSION docs/img/paper

draws figures 1 to 7 as small JPEGs, and prints what the page of the paper shows of them.
"""

from __future__ import annotations

import argparse
import csv
import io
from importlib.resources import files
from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.api.job import open_session
from mammometry.report.figures.catalogue import find_paper_figure
from mammometry.study.agreement import PairedMeasurements, agreement

WIDTH_PX, QUALITY = 1100, 72
"""Of the pictures on the page: a figure takes about 100 kB."""
FIGURES = {
    1: "Stereo pairs, disparities, confidence and range images.",
    2: "The mesh of each range image, with dents at depth discontinuities.",
    3: "Where two range images disagree: a section, with the directions to both cameras.",
    4: "All range images at one scale, darker where nearer.",
    5: "Data that are removed, by the angle (rows) and the tolerance (columns).",
    6: "The first watertight surface.",
    7: "The surface after the elastic repair.",
}
"""Number → what we draw there."""
STATISTICS = {
    "mean_difference": ("mean difference, cc", "11.12", "+.2f"),
    "sd": ("standard deviation, cc", "23.23", ".2f"),
    "sem": ("standard error of the mean, cc", "7.74", ".2f"),
    "mdc_of_mean": ("1.96 √2 times that, cc", "21.85", ".2f"),
    "icc_2_1": ("ICC(2,1)", "0.9945", ".5f"),
    "t": ("paired t", "1.4365", "+.3f"),
    "p": ("p", "0.1888", ".3f"),
    "slope": ("slope of the difference on the mean", "", "+.4f"),
}
"""Figure of `Agreement` → words, what is printed, form."""


def draw(session: Path, out: Path) -> str:
    """Draw all figures and return them as Markdown."""
    job = open_session(session)
    source = (job.plan, job.inputs, job.settings)
    out.mkdir(parents=True, exist_ok=True)
    rms_px = job.calibrate().rms_px
    lines = [
        "| error of the calibration | printed | here |",
        "| --- | --- | --- |",
        f"| target projected back, px | 0.2 to 0.5 | {rms_px:.3f} (RMS) |",
    ]
    for number, words in FIGURES.items():
        picture = Image.open(io.BytesIO(find_paper_figure(number)(source).printed("png"))).convert("RGB")
        picture.thumbnail((WIDTH_PX, WIDTH_PX))
        path = out / f"figure-{number}.jpg"
        picture.save(path, quality=QUALITY, optimize=True)
        lines += ["", f"**Figure {number}.** {words}", "", f"![Figure {number}: {words}](img/paper/{path.name})"]
    return "\n".join(lines)


def table_1(ours: str) -> str:
    """Table 1 as printed, beside nine virtual casts (the CSV of `mammometry study phantoms`), with what follows."""
    printed_rows = list(
        csv.reader((files("mammometry.study.paper") / "table_1.csv").read_text(encoding="utf-8").splitlines())
    )[1:]
    our_rows = list(csv.reader(ours.splitlines()))[1:]
    lines = [
        "| | printed: water cc | photographs cc | difference cc | here: true cc | photographs cc | difference cc |",
        "| --- " * 7 + "|",
    ]
    pairs = [np.array([row[1:3] for row in rows], dtype=np.float64).T for rows in (printed_rows, our_rows)]
    (water, imaging), (true, measured) = pairs
    for number, row in enumerate(zip(water, imaging, true, measured, strict=True), 1):
        a, b, c, d = row
        lines.append(f"| {number} | {a:.1f} | {b:.1f} | {b - a:+.1f} | {c:.1f} | {d:.1f} | {d - c:+.2f} |")
    names = tuple(str(number) for number in range(1, len(water) + 1))
    recomputed, virtual = (
        agreement(
            PairedMeasurements(
                names=names,
                reference=reference,
                measured=values,
                reference_name="reference",
                measured_name="photographs",
                unit="cc",
            )
        ).figures()
        for reference, values in pairs
    )
    lines += ["", "| | printed | from the printed table | here |", "| --- " * 4 + "|"]
    for key, (words, printed, form) in STATISTICS.items():
        lines.append(f"| {words} | {printed} | {recomputed[key]:{form}} | {virtual[key]:{form}} |")
    return "\n".join(lines)


def main() -> None:
    """Draw the figures and print what the page shows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("session", type=Path)
    parser.add_argument("out", type=Path, help="folder of the pictures")
    arguments = parser.parse_args()
    print(draw(arguments.session, arguments.out))


if __name__ == "__main__":
    main()
