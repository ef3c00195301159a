"""Many visits together: cohorts, charts, comparisons."""
