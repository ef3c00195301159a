"""What a virtual session is made from."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.simulate.situation import Situation

if TYPE_CHECKING:  # The command line takes its defaults from here, and must not wait for NumPy.
    from mammometry.simulate.subjects.user_mesh import MeshFile


_UNDISTURBED = Situation()


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionRecipe:
    """Recipe of a virtual session, except for how pictures are taken. Those are taken by `studio.Studio`."""

    rig: str = "reference"
    """``reference`` (eight cameras, four pairs), or a rig's TOML file. ``reference:front,floor`` keeps only these
    pairs.
    """
    subject: str = "plaster_5"
    """A name in `subjects.registry.SUBJECTS`, or the path of a PLY, OBJ or STL."""
    scale: float = 0.25
    """Size of the pictures relative to the rig's full size: 0.25 of the reference rig's 4504 × 3000 is 1126 × 750."""
    seed: int = 7
    """Seed of everything random: errors of the rig, poses, shape, mottling, noise."""
    poses: int = 8
    """Of the calibration target."""
    mesh_file: MeshFile | None = None
    """Unit and attitude of a mesh that is the subject."""
    situation: Situation = _UNDISTURBED
    """What disturbs the capture."""

    @property
    def line(self) -> str:
        """Comment in session.toml that says how the session was made."""
        rig, subject = (json.dumps(Path(name).name if "/" in name else name) for name in (self.rig, self.subject))
        made = f"# rig {rig}, subject {subject}, scale {self.scale}, seed {self.seed}, {self.poses} poses"
        return f"{made}, disturbed by {self.situation}" if self.situation.disturbances else made
