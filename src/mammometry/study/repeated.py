"""Differences of two methods where a subject has several pairs of measurements.

The true value may vary between the pairs of one subject, as between both breasts of a woman: Bland and Altman, Journal
of Biopharmaceutical Statistics 17 (2007) 571, section 3. The variance of one difference is the sum of a variance
between subjects and one within them, from a one-way analysis of variance with m₀ pairs a subject. The intervals combine
those of both mean squares by MOVER: Zou, Statistical Methods in Medical Research 22 (2013) 630. With one pair a subject
the mean and the standard deviation are the usual ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # it imports scipy.stats, which takes half a second, when that is used

from mammometry.geometry.arrays import Array, Float64, Int64


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedDifferences:
    """Mean and spread of differences, in the measurements' unit."""

    mean: float
    """Of all pairs."""
    sem: float
    """Standard error of the mean. It knows that pairs of one subject are alike."""
    df_quantile: float
    """Two-sided 95 % quantile of Student's t with as many degrees of freedom as there are subjects less one."""
    sd: float
    """Standard deviation of one difference of any subject."""
    sd_interval: tuple[float, float]
    """Its 95 % interval."""


def repeated_differences(differences: Float64[Array, " n"], subjects: Int64[Array, " n"]) -> RepeatedDifferences:
    """Analyse differences by subject.

    Args:
        differences: one a pair.
        subjects: number of each pair's subject, from 0, without gaps.

    Raises:
        ValueError: fewer than two subjects, or no subject with two pairs.
    """
    counts = np.bincount(subjects)
    total, n = int(counts.sum()), len(counts)
    if n < 2 or total == n or not counts.all():
        raise ValueError(f"two subjects and a subject with two pairs are needed, found {n} subjects and {total} pairs")
    mean = float(differences.mean())
    own = np.bincount(subjects, differences) / counts
    between = float(counts @ (own - mean) ** 2) / (n - 1)
    within = float(((differences - own[subjects]) ** 2).sum()) / (total - n)
    alike = float(counts @ counts) / total  # size of the subject that a pair chosen at random belongs to
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
