"""Matte casts and seven fixed pairs 41 to 45° apart: false motions and corrections.

    python -m benchmarks.accuracy.matte OUT [--seeds 5 6] [--scale 0.142] [--contrast 0.005 0.003]

The cameras are the true ones, so nothing may be corrected. Of each cast: evidence for a motion by the pairs' surfaces,
what features that pairs share say of it (`surface.motion.feature_evidence`), and what was done. At the scale of 0.142
photographs have 640 × 426 pixels. Plaster of a contrast of 0.003 is textureless: nothing can be matched.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from mammometry.api.job import open_session
from mammometry.base.errors import MammometryError
from mammometry.job.stages import surface
from mammometry.settings import Settings
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio
from mammometry.surface.motion.motion_detection import MotionEstimate, summary

_RIG = Path(__file__).parent / "rigs" / "seven.toml"


def found(out: Path, seed: int, scale: float, contrast: float) -> MotionEstimate:
    """Simulate a cast if it is not there, and find what moved."""
    session = out / f"plaster_{seed}-{scale:g}-{contrast:g}"
    if not session.exists():
        recipe = SessionRecipe(rig=str(_RIG), subject=f"plaster_{seed}", scale=scale, seed=seed, poses=1)
        skin = make_skin("plain", contrast=contrast)
        write_session(session, recipe, Studio(skin=skin, film=Film().with_noise(1.0)))
        shutil.copy(session / "truth" / "cameras.json", session / "cameras.json")
    job = open_session(session, Settings())
    with job.store.taken():
        return job.plan[surface.stillness]()


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[5, 6])
    parser.add_argument("--scale", type=float, default=0.142)
    parser.add_argument("--contrast", type=float, nargs="+", default=[0.005, 0.003])
    arguments = parser.parse_args()
    print("| plaster | contrast | evidence | features: share | verdict | corrected | said |\n" + "| --- " * 7 + "|")
    for contrast in arguments.contrast:
        for seed in arguments.seeds:
            head = f"| {seed} | {contrast:g} |"
            try:
                stillness = found(arguments.out, seed, arguments.scale, contrast)
            except MammometryError as error:
                print(f"{head} | | | | refused: {str(error)[:160]} |", flush=True)
                continue
            told = stillness.confirmation
            said = (
                " | |" if told is None else f" {told.share:.2f} ± {told.std:.2f} ({told.features}) | {told.verdict} |"
            )
            corrected = "**YES**" if stillness.corrected else "no"
            print(f"{head} {stillness.evidence:.0f} |{said} {corrected} | {summary(stillness)} |", flush=True)


if __name__ == "__main__":
    main()
