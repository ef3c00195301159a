"""Cases of a test of which the default run takes the first ones."""

from collections.abc import Iterable

import pytest
from _pytest.mark import ParameterSet


def first(count: int, cases: Iterable[object]) -> list[ParameterSet]:
    """Mark all cases but the first ``count`` as slow.

    Args:
        count: number of cases of the default run.
        cases: values of ``parametrize``; a tuple holds one value per parameter name.
    """
    values = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*each, marks=[pytest.mark.slow] if n >= count else []) for n, each in enumerate(values)]
