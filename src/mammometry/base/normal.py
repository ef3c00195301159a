"""Two numbers of the normal distribution."""

MAD = 1.4826
"""Standard deviation over the median absolute deviation."""
COVERAGE_95 = 1.96
"""Standard deviations on either side that hold 95 %."""
