"""Kinds of cameras that can be driven: a line each."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable
from types import ModuleType
from typing import TypeAlias

from mammometry.base.errors import SettingsError
from mammometry.base.registry import Registry
from mammometry.capture.camera import Backend, Devices

Opener: TypeAlias = Callable[[Devices], Backend]
BACKENDS: Registry[Opener] = Registry("back-end", package="mammometry.capture.backends")


def library(name: str) -> ModuleType:
    """Import a maker's library.

    Those that SWIG made warn when they are imported, and end the whole program where warnings are errors.

    Raises:
        ImportError: it is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(name)


def missing(backend: str, what: str, remedy: str) -> SettingsError:
    """The error of a back-end whose program or package is not installed."""
    return SettingsError(f"back-end {backend}", found=f"no {what}", expected="it installed", remedy=remedy)
