"""The matcher's error against the least error of a linear filter on the same pictures.

    python -m benchmarks.accuracy.bound CAPTURES [--subject plaster_a] [--pair left]

The true disparity d of a patch is its quadratic trend, taken as known, and a relief with the power spectrum P(f). A
pixel's picture tells d with white noise of variance w: least squares in a Gaussian window of σ, made at the true
disparity, scatters by v = w / (4 π σ²) about it, so that w = 4 π σ² v. The linear filter of least expected error is
Wiener's, P / (P + w), and leaves

    mean over f of  P w / (P + w)

(Wiener 1949). It knows each patch's relief power, averaged over directions; the matcher does not. It prints, over all
patches of 64 × 64 judged pixels that the pair has, the root mean squares of bound and error, their ratio, and the
medians (0.6745 σ of a patch, the median over the patches).

Colour: of the three channels, high-passed, the residuals after the warp by the true disparity have the covariance N,
and the slopes of both pictures together S (the cross products of one picture's with the other's, which noise leaves
alone). A sum of channels with the weights a tells (aᵀ S a) / (aᵀ N a) of the disparity: at best the largest eigenvalue
of N⁻¹ S; all three as separate observations tell its trace. "Best sum" and "three channels" are what the standard
deviation would shrink by, in %, against luma.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks.pairs import Case, captures, cases
from mammometry.base.photograph import LUMA, Photograph
from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.correlation_kernels import least_squares, mean_slope, slope_ratio, warp_rows
from mammometry.matching.dense.least_squares_step import FLAT_DEVIATION, prepare_side
from mammometry.matching.dense.match import match
from mammometry.matching.filters import blur, gaussian_taps
from mammometry.matching.pyramid import Level
from mammometry.matching.rectify import rectify
from mammometry.matching.settings import MatchSettings

_SETTINGS = MatchSettings(resolution="full")
_SIGMA_PX = _SETTINGS.window_px / np.sqrt(12)
_PATCH, _STRIDE = 64, 16
_FROM_EDGE_PX = 8.0  # whole windows only


def patch_bounds(case: Case) -> tuple[Array, Array]:
    """Variance that a Wiener filter would leave, and the matcher's mean squared error, of each patch; px²."""
    judged = case.truth.judged & (case.truth.edge_px > _FROM_EDGE_PX)
    true = np.nan_to_num(case.truth.d_h_px).astype(np.float32)
    scatter, variance = _least_squares_at(case, true, judged)
    whole = ndimage.binary_erosion(judged, iterations=round(3 * _SIGMA_PX))
    # What the windows' own variance leaves out: noise that is correlated from pixel to pixel.
    correlated = float(np.mean(scatter[whole] ** 2 / variance[whole]))
    found = match(case.pair, _SETTINGS)
    error = np.where(found.valid, found.d_h_px - true, np.nan)
    rows, columns = np.mgrid[:_PATCH, :_PATCH].reshape(2, -1) / _PATCH
    trend = np.stack([np.ones_like(rows), rows, columns, rows**2, columns**2, rows * columns], axis=1)
    fade = np.outer(*[np.hanning(_PATCH + 2)[1:-1]] * 2)
    fade /= np.sqrt(np.mean(fade**2))
    frequency = np.hypot(np.fft.fftfreq(_PATCH)[:, None], np.fft.fftfreq(_PATCH)[None]) * _PATCH
    ring = np.rint(frequency).astype(int)
    bounds, reached = [], []
    for top in range(0, judged.shape[0] - _PATCH, _STRIDE):
        for left in range(0, judged.shape[1] - _PATCH, _STRIDE):
            part = (slice(top, top + _PATCH), slice(left, left + _PATCH))
            if not judged[part].all() or np.isnan(error[part]).all():
                continue
            values = true[part].astype(np.float64).ravel()
            relief = (values - trend @ np.linalg.lstsq(trend, values, rcond=None)[0]).reshape(_PATCH, _PATCH)
            power = np.abs(np.fft.fft2(relief * fade)) ** 2 / _PATCH**2
            power = (np.bincount(ring.ravel(), power.ravel()) / np.bincount(ring.ravel()))[ring]
            noise = 4 * np.pi * _SIGMA_PX**2 * correlated * float(np.median(variance[part]))
            bounds.append(np.mean(power * noise / (power + noise)))
            reached.append(np.nanmean(error[part] ** 2))
    return np.array(bounds), np.array(reached)


def _least_squares_at(
    case: Case, true: Float32[Array, "h w"], judged: Bool[Array, "h w"]
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """The windows' corrections of the true disparity, and the variances that they claim."""
    here, there = (
        prepare_side(Level(image=image, mask=np.ones_like(mask)), _SIGMA_PX)
        for image, mask in ((case.pair.left_image, case.pair.left_mask), (case.pair.right_image, case.pair.right_mask))
    )
    value, slope, _ = warp_rows(there.coefficients, there.mask, -true)
    ratio = slope_ratio(here.coefficients, judged, there.coefficients, there.mask, -true)
    mean_slope(slope, here.coefficients, -true, ratio)
    weight = judged.astype(np.float32)
    floor = FLAT_DEVIATION**2
    rows = (0, true.shape[0])
    shift, _, _, variance = least_squares(here.image, value, slope, weight, gaussian_taps(_SIGMA_PX), floor, rows)
    return shift, variance


def colour_gains(case: Case) -> tuple[float, float]:
    """By how much the best sum of the channels, and all three side by side, would shrink σ; shares of luma's."""
    judged = case.truth.judged & (case.truth.edge_px > _FROM_EDGE_PX)
    shift = -np.nan_to_num(case.truth.d_h_px).astype(np.float32)
    mass = np.maximum(blur(judged.astype(np.float32), gaussian_taps(_SIGMA_PX)), np.float32(1e-3))

    def around(image: Array) -> Float32[Array, "h w"]:
        return np.asarray(blur((judged * image).astype(np.float32), gaussian_taps(_SIGMA_PX)) / mass)

    residuals, slopes, own_slopes = [], [], []
    for channel in range(3):
        left, right = (
            Photograph(name=photograph.name, pixels=np.ascontiguousarray(photograph.pixels[..., channel]))
            for photograph in case.photographs
        )
        pair = rectify(case.true_cameras, left, right, *case.foregrounds)
        here, there = (
            prepare_side(Level(image=image, mask=np.ones(image.shape, dtype=bool)), _SIGMA_PX)
            for image in (pair.left_image, pair.right_image)
        )
        value, slope, _ = warp_rows(there.coefficients, there.mask, shift)
        mean_here, mean_value = around(here.image), around(value)
        gain = (around(here.image * value) - mean_here * mean_value) / np.maximum(
            around(value**2) - mean_value**2, np.float32(1e-9)
        )
        residuals.append((here.image - mean_here - gain * (value - mean_value))[judged])
        slopes.append(slope[judged])
        own_slopes.append((np.gradient(here.image, axis=1) / (1 + np.gradient(shift, axis=1)))[judged])
    noise = np.cov(residuals)
    steep = np.array(slopes) @ np.array(own_slopes).T / len(slopes[0])
    steep = (steep + steep.T) / 2
    luma = LUMA.astype(np.float64)
    luma_only = (luma @ steep @ luma) / (luma @ noise @ luma)
    each = np.linalg.solve(noise, steep)
    best = float(np.linalg.eigvals(each).real.max())
    return float(np.sqrt(best / luma_only) - 1), float(np.sqrt(np.trace(each) / luma_only) - 1)


def main() -> None:
    """Print a row a pair."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("--subject", action="append", default=[], help="one subject; may be repeated; default: all")
    parser.add_argument("--pair", action="append", default=[], help="one pair; may be repeated; default: all")
    arguments = parser.parse_args()
    print(
        "| pair | patches | bound, RMS px | reached | ratio | bound, median px | reached | best sum | three channels |"
    )
    print("| --- " * 9 + "|")
    with tempfile.TemporaryDirectory() as scratch:
        for capture in captures(arguments.captures, arguments.subject, Path(scratch)):
            for case in cases(capture, arguments.pair, _SETTINGS):
                if case.truth.step > 1:
                    raise SystemExit(
                        f"{case.pair.name}: for pictures whose every pixel is judged, of a quarter of the size"
                    )
                bounds, reached = patch_bounds(case)
                colours = " | ".join(f"{100 * gain:.1f} %" for gain in colour_gains(case))
                if not len(bounds):
                    print(f"| {capture.name} {case.pair.name} | 0 | – | – | – | – | – | {colours} |", flush=True)
                    continue
                least, got = np.sqrt(bounds.mean()), np.sqrt(reached.mean())
                medians = [0.6745 * float(np.median(np.sqrt(values))) for values in (bounds, reached)]
                print(
                    f"| {capture.name} {case.pair.name} | {len(bounds)} | {least:.4f} | {got:.4f} | {got / least:.2f} "
                    f"| {medians[0]:.3f} | {medians[1]:.3f} | {colours} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
