"""Ours, OpenCV's SGBM (3WAY, HH) and StereoBM on the same rectified pairs: error, completeness, time, memory.

    python -m benchmarks.matching SESSION [--cameras estimated] [--pair front]
    python -m benchmarks.matching ../shared/data/rendered --subject torso
    python -m benchmarks.matching --sweeps docs/img
    python -m benchmarks.matching --aloe ../shared/data/opencv_samples

SESSION is a folder of `mammometry simulate`, or captures laid out as ../shared/data/rendered. Every matcher runs in a
process of its own, on the same rectified pictures, after a small pair has warmed it. The rivals are told the true
disparity range; ours finds it. `--sweeps` renders a plaster at a quarter of the size, with weaker texture and with
more noise, and draws the errors, and predicted against observed errors, there. Truth is read here and nowhere in the
product.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.pairs import Capture, calibrated, captures, cases
from mammometry.base.machine.system import reuse_freed_memory
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.matching.dense.match import DisparityMap, match
from mammometry.matching.rectify import RectifiedPair
from mammometry.matching.settings import MatchSettings
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio
from mammometry.study.accuracy_matching import TrueDisparity, judge_disparity

_WARMING_PX = 96
_SETTINGS = MatchSettings(resolution="full")


# --- Matchers --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Range:
    """Disparities a rival searches, whole pixels, a multiple of sixteen wide."""

    lowest: int
    count: int


def ours(pair: RectifiedPair, _: Range) -> DisparityMap:
    """The product's matcher."""
    return match(pair, _SETTINGS)


def sgbm(mode: int) -> Callable[[RectifiedPair, Range], DisparityMap]:
    """OpenCV's semi-global block matcher with the penalties of its documentation and a left–right check."""

    def run(pair: RectifiedPair, searched: Range) -> DisparityMap:
        matcher = cv2.StereoSGBM.create(
            minDisparity=searched.lowest,
            numDisparities=searched.count,
            blockSize=5,
            P1=8 * 25,
            P2=32 * 25,
            disp12MaxDiff=1,
            uniquenessRatio=10,
            speckleWindowSize=100,
            speckleRange=2,
            mode=mode,
        )
        return _from_opencv(pair, matcher, searched)

    return run


def block_matcher(pair: RectifiedPair, searched: Range) -> DisparityMap:
    """OpenCV's StereoBM, 21 pixel windows."""
    matcher = cv2.StereoBM.create(numDisparities=searched.count, blockSize=21)
    matcher.setMinDisparity(searched.lowest)
    matcher.setDisp12MaxDiff(1)
    matcher.setUniquenessRatio(10)
    matcher.setSpeckleWindowSize(100)
    matcher.setSpeckleRange(2)
    return _from_opencv(pair, matcher, searched)


def _from_opencv(pair: RectifiedPair, matcher: Any, searched: Range) -> DisparityMap:
    """Run it on 8-bit pictures, padded so that no column is lost to the search, and keep what is subject."""
    pad = searched.count + abs(searched.lowest)
    left, right = (
        cv2.copyMakeBorder(np.round(255 * np.clip(image, 0, 1)).astype(np.uint8), 0, 0, pad, pad, cv2.BORDER_REPLICATE)
        for image in (pair.left_image, pair.right_image)
    )
    found = matcher.compute(left, right)[:, pad:-pad].astype(np.float32) / 16
    valid = (found >= searched.lowest) & pair.left_mask
    found = np.where(valid, found, np.float32(0))
    return DisparityMap(
        name=pair.name,
        left=pair.left,
        right=pair.right,
        d_h_px=found,
        d_v_px=np.zeros_like(found),
        confidence=valid.astype(np.float32),
        sigma_px=valid.astype(np.float32),
        valid=valid,
        weak=np.zeros_like(valid),
    )


MATCHERS: Mapping[str, Callable[[RectifiedPair, Range], DisparityMap]] = {
    "ours": ours,
    "SGBM 3WAY": sgbm(cv2.STEREO_SGBM_MODE_SGBM_3WAY),
    "SGBM HH": sgbm(cv2.STEREO_SGBM_MODE_HH),
    "StereoBM": block_matcher,
}


# --- Running one -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """What one matcher made of one pair, and what that took."""

    found: DisparityMap
    seconds: float
    cpu_seconds: float
    peak_mb: float
    """Beyond what the process held when the pair was loaded."""


def run_alone(name: str, pair: RectifiedPair, searched: Range) -> Run:
    """Run a matcher in a fresh process, warmed by a small piece of the pair."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_run, (name, pair, searched))


def _run(name: str, pair: RectifiedPair, searched: Range) -> Run:
    cv2.setNumThreads(1)
    reuse_freed_memory()  # as the job does
    MATCHERS[name](_piece(pair), _narrowed(searched))
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    before = _memory_kb("VmRSS")
    begun, cpu_begun = time.perf_counter(), time.process_time()
    found = MATCHERS[name](pair, searched)
    return Run(
        found=found,
        seconds=time.perf_counter() - begun,
        cpu_seconds=time.process_time() - cpu_begun,
        peak_mb=(_memory_kb("VmHWM") - before) / 1024,
    )


def _memory_kb(field: str) -> int:
    """Resident memory now (VmRSS) or at its peak (VmHWM), as Linux tells."""
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(field))
    return int(line.split()[1])


def _narrowed(searched: Range) -> Range:
    """The same range, no wider than a small piece allows."""
    return Range(searched.lowest, 16)


def _piece(pair: RectifiedPair) -> RectifiedPair:
    """The middle of the subject, of both pictures at once: enough to compile and load every kernel."""
    rows, columns = np.nonzero(pair.left_mask & pair.right_mask)
    top, left = (max(0, int(np.median(c)) - _WARMING_PX // 2) for c in (rows, columns))
    part = (slice(top, top + _WARMING_PX), slice(left, left + _WARMING_PX))
    height, width = pair.left_image[part].shape
    whole = np.ones((height, width), dtype=bool)
    cameras = [
        replace(camera, size_wh=(width, height), matrix=camera.matrix.copy()) for camera in (pair.left, pair.right)
    ]
    image = np.ascontiguousarray(pair.left_image[part])  # with itself: a match is certain
    return RectifiedPair(
        name=pair.name,
        left=cameras[0],
        right=cameras[1],
        left_image=image,
        right_image=image,
        left_mask=whole,
        right_mask=whole,
    )


# --- Comparing -------------------------------------------------------------------------------------------------------


def true_range(truth: TrueDisparity) -> Range:
    """The true disparities, rounded outwards."""
    true = truth.d_h_px[truth.judged]
    lowest = math.floor(float(true.min())) - 2
    return Range(lowest, 16 * math.ceil((float(true.max()) + 3 - lowest) / 16))


def compare(capture: Capture, pairs: list[str], matchers: list[str], rig: Rig | None) -> list[dict[str, Any]]:
    """One row a pair and matcher."""
    rows = []
    for case in cases(capture, pairs, _SETTINGS, rig):
        for name in matchers:
            run = run_alone(name, case.pair, true_range(case.truth))
            judged = judge_disparity(case.truth, run.found)
            figures = asdict(judged) if judged is not None else {}
            rows.append(
                {
                    "pair": case.pair.name,
                    "matcher": name,
                    "megapixels": case.pair.left_mask.size / 1e6,
                    **figures,
                    "prepare_seconds": case.prepare_seconds,
                    "seconds": run.seconds,
                    "cpu_seconds": run.cpu_seconds,
                    "peak_mb": run.peak_mb,
                }
            )
            print("| " + " | ".join(_cells(rows[-1])) + " |", flush=True)
    return rows


_COLUMNS = {
    "megapixels": ("Mpx", ".2f"),
    "median_px": ("median px", ".3f"),
    "p95_px": ("95 % px", ".3f"),
    "beyond_1_px_percent": ("> 1 px %", ".2f"),
    "complete_percent": ("complete %", ".1f"),
    "depth_bias_mm": ("bias mm", "+.3f"),
    "near_edge_median_px": ("< 20 px of edge", ".3f"),
    "rim_bias_mm": ("rim mm", "+.3f"),
    "cpu_seconds": ("CPU s", ".1f"),
    "seconds": ("s", ".1f"),
    "peak_mb": ("MB", ".0f"),
}


def _cells(row: dict[str, Any]) -> list[str]:
    return [row["pair"], row["matcher"], *(format(row.get(key, math.nan), form) for key, (_, form) in _COLUMNS.items())]


# --- Sweeps ----------------------------------------------------------------------------------------------------------

_CONTRASTS = (1.0, 0.5, 0.25, 0.125)
_NOISES = (1.0, 2.0, 4.0)
_CONTRAST = 0.045  # of the plaster's mottling, as it comes


def sweep(out: Path) -> list[dict[str, Any]]:
    """Render, match and judge; write matching-sweeps.png and matching-sigma.png."""
    rows: list[dict[str, Any]] = []
    reliability: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    settings = [("contrast", share, 1.0) for share in _CONTRASTS] + [("noise", 1.0, noise) for noise in _NOISES[1:]]
    with tempfile.TemporaryDirectory() as scratch:
        for kind, contrast, noise in settings:
            folder = Path(scratch) / f"{kind}-{contrast}-{noise}"
            studio = Studio(skin=make_skin("plaster", contrast=contrast * _CONTRAST), film=Film().with_noise(noise))
            write_session(folder, SessionRecipe(rig="reference:front", subject="plaster_6", seed=12, poses=1), studio)
            (case,) = cases(Capture(kind, folder, folder / "truth"), [], _SETTINGS)
            for name in MATCHERS:
                found = MATCHERS[name](case.pair, true_range(case.truth))
                judged = judge_disparity(case.truth, found)
                figures = asdict(judged) if judged is not None else {"median_px": math.nan, "complete_percent": 0.0}
                rows.append({"matcher": name, "contrast": contrast, "noise": noise, **figures})
                if name == "ours":
                    reliability[f"contrast × {contrast:g}, noise × {noise:g}"] = _reliability(case.truth, found)
    out.mkdir(parents=True, exist_ok=True)
    _draw_sweeps(rows, out / "matching-sweeps.png")
    _draw_reliability(reliability, out / "matching-sigma.png")
    return rows


def _reliability(truth: TrueDisparity, found: DisparityMap) -> tuple[np.ndarray, np.ndarray]:
    """Predicted σ, and the errors' root mean square (cut at five σ), in ten classes of equal number."""
    some = slice(None, None, truth.step)
    chosen = truth.judged & found.valid[some, some]
    sigma = found.sigma_px[some, some][chosen]
    error = np.clip((found.d_h_px[some, some] - truth.d_h_px)[chosen], -5 * sigma, 5 * sigma)
    order = np.array_split(np.argsort(sigma), 10)
    return (
        np.array([np.sqrt(np.mean(sigma[k] ** 2)) for k in order]),
        np.array([np.sqrt(np.mean(error[k] ** 2)) for k in order]),
    )


def _draw_sweeps(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(9, 6), sharex="col", layout="constrained")
    for column, (key, other, label) in enumerate(
        (("contrast", "noise", "texture contrast, × usual"), ("noise", "contrast", "noise, × usual"))
    ):
        for row, (figure_key, title) in enumerate(
            (("median_px", "median error, px"), ("complete_percent", "complete, %"))
        ):
            for name in MATCHERS:
                chosen = sorted((r[key], r[figure_key]) for r in rows if r["matcher"] == name and r[other] == 1.0)
                axes[row, column].plot(*zip(*chosen, strict=True), marker="o", label=name)
            axes[row, column].set(xscale="log", ylabel=title)
            ticks = sorted({r[key] for r in rows})
            axes[row, column].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            axes[row, column].minorticks_off()
            axes[row, column].grid(alpha=0.3)
        axes[0, column].set_yscale("log")
        axes[0, column].set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1], ["0.02", "0.05", "0.1", "0.2", "0.5", "1"])
        axes[0, column].minorticks_off()
        axes[1, column].set_xlabel(label)
    axes[0, 0].legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_reliability(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.5, 5.5), layout="constrained")
    for label, (predicted, observed) in curves.items():
        axes.plot(predicted, observed, marker="o", label=label)
    limits = [0.5 * min(p.min() for p, _ in curves.values()), 2 * max(p.max() for p, _ in curves.values())]
    axes.plot(limits, limits, color="0.3", linewidth=1)
    axes.set(xscale="log", yscale="log", xlim=limits, ylim=limits)
    axes.set(xlabel="predicted σ of d_H, px", ylabel="observed error (root mean square), px")
    ticks = [0.02, 0.05, 0.1, 0.2, 0.5]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


# --- A real pair -----------------------------------------------------------------------------------------------------

_BAD_PX = 2.0


def aloe(samples: Path) -> list[dict[str, Any]]:
    """OpenCV's aloe, a rectified photograph of plants with true disparities in whole pixels: ours beside SGBM (HH).

    Everything may be surface, no range is told to ours. Bad are matched pixels that are off by more than 2 px.
    """
    left, right, true = (
        cv2.imread(str(samples / name), cv2.IMREAD_GRAYSCALE) for name in ("aloeL.jpg", "aloeR.jpg", "aloeGT.png")
    )
    if left is None or right is None or true is None:
        raise SystemExit(f"{samples}: aloeL.jpg, aloeR.jpg and aloeGT.png are not all there")
    height, width = left.shape
    cameras = [
        Camera(
            name=name,
            size_wh=(width, height),
            matrix=np.array([[1000.0, 0, width / 2], [0, 1000.0, height / 2], [0, 0, 1]]),
            distortion=np.zeros(5),
            camera_from_world=Transform(rotation=np.eye(3), translation_mm=np.array([-x_mm, 0.0, 0.0])),
        )
        for name, x_mm in (("aloe_left", 0.0), ("aloe_right", 100.0))
    ]
    everything = np.ones(left.shape, dtype=bool)
    pair = RectifiedPair(
        name="aloe",
        left=cameras[0],
        right=cameras[1],
        left_image=left.astype(np.float32) / 255,
        right_image=right.astype(np.float32) / 255,
        left_mask=everything,
        right_mask=everything.copy(),
    )
    known = true > 0
    searched = Range(int(true[known].min()) - 2, 16 * math.ceil((int(np.ptp(true[known])) + 5) / 16))
    rows = []
    for name in ("ours", "SGBM HH"):
        found = MATCHERS[name](pair, searched)
        matched = known & found.valid
        error = np.abs(found.d_h_px - true.astype(np.float32))[matched]
        rows.append(
            {
                "pair": "aloe",
                "matcher": name,
                "matched_percent": float(100 * matched.sum() / known.sum()),
                "bad_percent": float(100 * np.mean(error > _BAD_PX)),
            }
        )
        print(f"{name:10} matched {rows[-1]['matched_percent']:.1f} %, bad {rows[-1]['bad_percent']:.2f} %")
    return rows


# --- Command ---------------------------------------------------------------------------------------------------------


def main() -> None:
    """Print the table; write JSON where asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("session", type=Path, nargs="?", help="a simulated session, or rendered captures")
    parser.add_argument("--subject", default="plaster_a", help="of rendered captures")
    parser.add_argument("--cameras", choices=("true", "estimated"), default="true")
    parser.add_argument("--pair", action="append", default=[], help="one pair; may be repeated; default: all")
    parser.add_argument("--matcher", action="append", default=[], choices=tuple(MATCHERS), help="default: all")
    parser.add_argument("--sweeps", type=Path, metavar="FOLDER", help="draw the contrast and noise sweeps there")
    parser.add_argument("--aloe", type=Path, metavar="FOLDER", help="OpenCV's samples, with the aloe pair")
    parser.add_argument("--json", type=Path, help="write the figures there")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if arguments.sweeps is not None:
        rows += sweep(arguments.sweeps)
        for row in rows:
            print(
                f"{row['matcher']:10} contrast × {row['contrast']:g}, noise × {row['noise']:g}: "
                f"median {row['median_px']:.3f} px, complete {row['complete_percent']:.1f} %"
            )
    if arguments.aloe is not None:
        rows += aloe(arguments.aloe)
    if arguments.session is not None:
        head = ["pair", "matcher", *(title for title, _ in _COLUMNS.values())]
        print(f"{arguments.session.name}\n\n| " + " | ".join(head) + " |\n| " + " | ".join(["---"] * len(head)) + " |")
        with tempfile.TemporaryDirectory() as scratch:
            (capture,) = captures(arguments.session, [arguments.subject], Path(scratch))
            rig = calibrated(capture.session) if arguments.cameras == "estimated" else None
            rows += compare(capture, arguments.pair, arguments.matcher or list(MATCHERS), rig)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
