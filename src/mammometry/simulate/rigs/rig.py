"""Virtual rigs by name: reference rig, TOML file, or some pairs."""

from __future__ import annotations

from pathlib import Path

from mammometry.geometry.camera import Rig
from mammometry.simulate.rigs.build import build_rig, pairs_of
from mammometry.simulate.rigs.plan import REFERENCE, RigPlan
from mammometry.simulate.rigs.rig_file import read_rig_plan


def reference_rig(scale: float, seed: int) -> Rig:
    """Build the reference rig.

    Raises:
        ValueError: the scale is not within 0.02 … 2.
    """
    return build_rig(REFERENCE, scale, seed)


def make_rig(name: str, scale: float, seed: int) -> Rig:
    """Build a rig by name, or some of its pairs.

    ``reference``, or ``reference:front`` / ``reference:front,floor``.

    Raises:
        ValueError: there is no rig, or no pair, of that name.
    """
    plan, pairs = find_plan(name)
    rig = build_rig(plan, scale, seed)
    return pairs_of(rig, pairs) if pairs else rig


def find_plan(name: str) -> tuple[RigPlan, tuple[str, ...]]:
    """Rig plan and pairs of ``reference``, ``reference:front``, ``rig.toml`` or ``rig.toml:front,floor``.

    Raises:
        ValueError: there is no rig of that name.
        SessionError: a rig's file that does not describe a rig.
    """
    base, _, pairs = name.partition(":")
    if base.lower().endswith(".toml"):
        plan = read_rig_plan(Path(base))
    elif base == REFERENCE.name:
        plan = REFERENCE
    else:
        raise ValueError(f"rigs are reference, a part of it as in reference:front, or a TOML file; found {name!r}")
    return plan, tuple(pairs.split(",")) if pairs else ()
