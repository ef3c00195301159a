"""Constants of the normal distribution."""

MAD = 1.4826
"""Ratio of the standard deviation to the median absolute deviation."""
COVERAGE_95 = 1.96
"""Standard deviations on each side of the mean that contain 95 %."""
