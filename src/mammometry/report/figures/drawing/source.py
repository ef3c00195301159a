"""What the paper's figures are drawn from."""

from __future__ import annotations

from typing import TypeAlias

from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.settings import Settings

Source: TypeAlias = tuple[Plan, Inputs, Settings]
"""A session's plan, what it brought, and the settings."""
