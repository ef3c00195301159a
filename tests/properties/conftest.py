"""Property tests: the same examples in every run, so that a failure seen once is seen again; no time limit each."""

from hypothesis import settings

settings.register_profile("reproducible", derandomize=True, deadline=None, max_examples=40)
settings.load_profile("reproducible")
