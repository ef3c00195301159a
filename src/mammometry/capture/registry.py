"""Kinds of cameras that can be driven: a line each."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from mammometry.base.errors import SettingsError
from mammometry.base.registry import Registry
from mammometry.capture.camera import Backend, Devices

Opener: TypeAlias = Callable[[Devices], Backend]
BACKENDS: Registry[Opener] = Registry("back-end", package="mammometry.capture.backends")


def missing(backend: str, what: str, remedy: str) -> SettingsError:
    """The error of a back-end whose program or package is not installed."""
    return SettingsError(f"back-end {backend}", found=f"no {what}", expected="it installed", remedy=remedy)
