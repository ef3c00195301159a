"""Recipe of a virtual session, and its disturbances in the notation of the command line.

A disturbance has a name and may have a size. ``rail,drift=0.02,removed=right`` is a rail in front of the body, a
rotation of all cameras by 0.02° after the calibration, and a right breast that was removed. The names are those of
`disturbances.registry.DISTURBANCES`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command line uses these defaults and must not import NumPy
    from mammometry.simulate.subjects.user_mesh import MeshFile


from collections.abc import Collection

from mammometry.base.errors import UnknownWordError


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """One disturbance."""

    name: str
    """Its name in the registry."""
    size: str = ""
    """Size or kind: a number or a word. Empty: the default."""

    def __str__(self) -> str:
        return f"{self.name}={self.size}" if self.size else self.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """All disturbances of one capture."""

    disturbances: tuple[Disturbance, ...] = ()
    """Each name occurs once. Their order does not matter."""

    def __str__(self) -> str:
        return ",".join(map(str, self.disturbances))

    def without(self, names: Collection[str]) -> Situation:
        """The situation without some disturbances, to compare captures with and without them."""
        return Situation(
            disturbances=tuple(disturbance for disturbance in self.disturbances if disturbance.name not in names)
        )


def parse_situation(text: str) -> Situation:
    """Parse ``rail,drift=0.02``.

    Raises:
        ValueError: a part has no name, or a name occurs twice.
    """
    found: dict[str, Disturbance] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, size = (word.strip() for word in part.partition("="))
        if not name or name in found:
            raise UnknownWordError("disturbances are written as rail,drift=0.02, each once", f"{text!r}")
        found[name] = Disturbance(name=name, size=size)
    return Situation(disturbances=tuple(found.values()))


_UNDISTURBED = Situation()


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionRecipe:
    """Recipe of a virtual session: everything except how the pictures are taken (`studio.Studio`)."""

    rig: str = "reference"
    """``reference`` (eight cameras, four pairs) or a rig's TOML file. ``reference:front,floor`` keeps only these pairs.
    """
    subject: str = "plaster_5"
    """A name in `subjects.registry.SUBJECTS`, or the path of a PLY, OBJ or STL file."""
    scale: float = 0.25
    """Size of the pictures relative to the rig's full size: 0.25 of the reference rig's 4504 × 3000 is 1126 × 750."""
    seed: int = 7
    """Seed of all random values: errors of the rig, poses, shape, mottling, noise."""
    poses: int = 8
    """Number of poses of the calibration target."""
    mesh_file: MeshFile | None = None
    """Unit and orientation, if the subject is a mesh file."""
    situation: Situation = _UNDISTURBED
    """Disturbances of the capture."""

    @property
    def line(self) -> str:
        """Comment for session.toml that states how the session was made."""
        rig, subject = (json.dumps(Path(name).name if "/" in name else name) for name in (self.rig, self.subject))
        made = f"# rig {rig}, subject {subject}, scale {self.scale}, seed {self.seed}, {self.poses} poses"
        return f"{made}, disturbed by {self.situation}" if self.situation.disturbances else made
