"""Differences of two methods if a subject has several pairs of measurements.

The true value may differ between the pairs of a subject, such as both breasts of a woman: Bland and Altman, Journal of
Biopharmaceutical Statistics 17 (2007) 571, section 3. The variance of one difference is the sum of the variances
between and within subjects, from a one-way analysis of variance with m₀ pairs per subject. The intervals of both mean
squares are combined by MOVER: Zou, Statistical Methods in Medical Research 22 (2013) 630. With one pair per subject,
these are the usual mean and standard deviation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.stats, which takes half a second to import, is imported on first use

from mammometry.geometry.arrays import Array, Float64, Int64


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedDifferences:
    """Mean and spread of differences, in the measurements' unit."""

    mean: float
    """Mean of all pairs."""
    sem: float
    """Standard error of the mean, if the pairs of a subject are correlated."""
    df_quantile: float
    """Two-sided 95 % quantile of Student's t; its degrees of freedom are the number of subjects minus 1."""
    sd: float
    """Standard deviation of one difference."""
    sd_interval: tuple[float, float]
    """Its 95 % interval."""


def repeated_differences(differences: Float64[Array, " n"], subjects: Int64[Array, " n"]) -> RepeatedDifferences:
    """Mean and spread of differences of pairs that are grouped by subject.

    Args:
        differences: one per pair.
        subjects: index of each pair's subject, from 0, without gaps.

    Raises:
        ValueError: there are fewer than two subjects, or no subject has two pairs.
    """
    counts = np.bincount(subjects)
    total, n = int(counts.sum()), len(counts)
    if n < 2 or total == n or not counts.all():
        raise ValueError(f"two subjects and a subject with two pairs are needed, found {n} subjects and {total} pairs")
    mean = float(differences.mean())
    own = np.bincount(subjects, differences) / counts
    between = float(counts @ (own - mean) ** 2) / (n - 1)
    within = float(((differences - own[subjects]) ** 2).sum()) / (total - n)
    alike = float(counts @ counts) / total  # expected number of pairs of the subject to which a random pair belongs
    pairs_each = (total - alike) / (n - 1)  # m₀
    of_subjects = max((between - within) / pairs_each, 0.0)
    variances = np.array([between / pairs_each, (1 - 1 / pairs_each) * within])
    df = np.array([n - 1, total - n])
    below, above = (variances * (df / scipy.stats.chi2.ppf(q, df) - 1) for q in (0.975, 0.025))
    variance = float(variances.sum())
    bounds = (variance - float(np.hypot(*below)), variance + float(np.hypot(*above)))
    return RepeatedDifferences(
        mean=mean,
        sem=math.sqrt((alike * of_subjects + within) / total),
        df_quantile=float(scipy.stats.t.ppf(0.975, n - 1)),
        sd=math.sqrt(variance),
        sd_interval=(math.sqrt(max(bounds[0], 0.0)), math.sqrt(bounds[1])),
    )
