"""Lay MultiDIC's sample data out as five sessions, one a speckled pair.

    python examples/multidic/make_sessions.py ../shared/data/multidic/sample_data build/multidic
    mammometry run build/multidic/1 --set matching.foreground.mode=all

Each session is complete; the others can take the first one's cameras instead of calibrating again:
``mammometry import-cameras build/multidic/2 build/multidic/1/results/calibrate/cameras.json``. Photographs are linked.
"""

import shutil
import sys
from pathlib import Path

CAMERAS = ("201", "202")
MANIFEST = Path(__file__).with_name("session.toml")


def link(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)
    target.symlink_to(source.resolve())


def main(sample_data: Path, out: Path) -> None:
    for number in range(1, 6):
        session = out / str(number)
        session.mkdir(parents=True, exist_ok=True)
        shutil.copy(MANIFEST, session / "session.toml")
        for camera in CAMERAS:
            speckled = sample_data / "speckledObjectImages" / camera / f"{camera}_{number}.jpg"
            link(speckled, session / "capture" / f"{camera}.jpg")
            cylinder = sample_data / "calibrationObjectImages" / f"{camera}.jpg"
            link(cylinder, session / "calibration" / "cylinder" / f"{camera}.jpg")
            for board in sorted((sample_data / "BAcheckerboardImages" / camera).glob("*.jpg")):
                link(board, session / "intrinsics" / camera / board.name)
    print(f"5 sessions in {out}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
