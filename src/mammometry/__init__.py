"""Breast volume, shape and symmetry from calibrated multi-view stereo photographs.

::

    import mammometry as mm

    job = mm.open_session("SESSION")
    print(job.run().volumes_cc)
"""

from typing import TYPE_CHECKING, Any

__version__ = "1.0.0"

if TYPE_CHECKING:
    from mammometry.api.dates import Comparison, compare
    from mammometry.api.job import Job, open_session
    from mammometry.api.results import Results
    from mammometry.base.errors import MammometryError
    from mammometry.job.method import method
    from mammometry.report.privacy import Privacy
    from mammometry.settings import Settings

__all__ = [
    "Comparison",
    "Job",
    "MammometryError",
    "Privacy",
    "Results",
    "Settings",
    "__version__",
    "compare",
    "method",
    "open_session",
]

_HOMES = {
    "Comparison": "mammometry.api.dates",
    "Job": "mammometry.api.job",
    "MammometryError": "mammometry.base.errors",
    "Privacy": "mammometry.report.privacy",
    "Results": "mammometry.api.results",
    "Settings": "mammometry.settings",
    "compare": "mammometry.api.dates",
    "method": "mammometry.job.method",
    "open_session": "mammometry.api.job",
}


def __getattr__(name: str) -> Any:
    """Import public names on first use, so that `import mammometry` is quick."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
