"""The matcher on held-out captures: six subjects, three rigs, contrasts, noises, skins.

    python -m benchmarks.accuracy.held_out --out FOLDER [--json FILE]

The sessions are rendered once into the folder; their cameras are estimated from their own boards. The columns are those
of `benchmarks.accuracy.matching`.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.accuracy.matching import measure, table
from benchmarks.road import each_as_it_ends
from mammometry.base.progress import StageProgress
from mammometry.matching.settings import MatchSettings
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.rigs.build import FULL_SIZE_WH
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio

_ROOT = Path(__file__).parents[2]
_EXAMPLE, _FAR = str(_ROOT / "examples" / "rig.toml"), str(_ROOT / "benchmarks" / "far_rig.toml")


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOut:
    """One capture."""

    seed: int
    subject: str
    rig: str = "reference"
    scale: float = 0.25
    """Of the rig's full pictures; about 1.1 megapixels each."""
    skin: str = "plaster"
    contrast: float | None = None
    """Of the mottling; the plaster's own is .045."""
    noise: float = 1.0


CAPTURES = (
    HeldOut(seed=101, subject="plaster_7", contrast=0.0225),
    HeldOut(seed=102, subject="plaster_2", rig=_FAR, noise=2.0),
    HeldOut(seed=103, subject="plaster_4", rig=_EXAMPLE, scale=0.375, noise=0.5),
    HeldOut(seed=104, subject="torso_4", rig=_FAR, skin="skin"),
    HeldOut(seed=105, subject="torso_6", skin="dark-skin"),
    HeldOut(seed=106, subject="torso_1", rig=_EXAMPLE, scale=0.375, skin="pale-skin", noise=2.0),
)


def matched(progress: StageProgress, capture: HeldOut, folder: str) -> list[dict[str, Any]]:
    """Render one capture, if it is not there, and match it: its rows."""
    progress("capture", 0.0)
    session = Path(folder)
    if not session.exists():
        studio = Studio(skin=make_skin(capture.skin, contrast=capture.contrast), film=Film().with_noise(capture.noise))
        recipe = SessionRecipe(rig=capture.rig, subject=capture.subject, scale=capture.scale, seed=capture.seed)
        write_session(session, recipe, studio)
    progress("match", 0.5)
    return measure(session, [], [], MatchSettings(resolution="full"), estimated=True)


def main() -> None:
    """Render what is not there yet, match, print the table; write JSON where asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="where the sessions lie")
    parser.add_argument("--json", type=Path, help="write the figures there")
    arguments = parser.parse_args()
    names = {f"{one.seed}-{one.subject}": one for one in CAPTURES}
    tasks = {name: (one, str((arguments.out / name).absolute())) for name, one in names.items()}
    width, height = FULL_SIZE_WH
    megapixels = 8 * width * height * max(one.scale for one in CAPTURES) ** 2 / 1e6
    found = dict(each_as_it_ends(matched, tasks, megapixels=megapixels))
    rows = [row for name in names for row in found[name]]
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    print(table(rows))


if __name__ == "__main__":
    from benchmarks.accuracy import held_out  # under its own name, by which other processes find what it hands them

    held_out.main()
