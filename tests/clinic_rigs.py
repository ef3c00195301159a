"""Seeds a clinic with a calibrated rig whose calibration has a poor photograph: ``python -m tests.clinic_rigs DIR``."""

import datetime
import json
import sys
from pathlib import Path

CAMERAS = ("front_left", "front_right")
POOR = "pose 02: 9 of 88 points of front_left were left out as outliers"


def main(folder: Path) -> dict[str, str]:
    """Make it, as far as it is not there. Role → login."""
    from tests import clinic_seed

    if not (folder / "clinic.toml").exists():
        clinic_seed.make(folder)
    logins = clinic_seed.logins(folder)
    from django.utils import timezone
    from tests.board_pictures import board_picture

    from mammometry.clinic import rig_history
    from mammometry.clinic.models import Rig
    from mammometry.clinic.site import the_clinic

    rig = Rig.objects.get()
    if not rig.calibrations.exists():
        calibration = rig_history.new_calibration(rig, None)
        calibration.taken_at = timezone.now() - datetime.timedelta(days=3)
        calibration.state, calibration.current = "done", True
        calibration.figures = {"verdict": "warn", "reasons": [POOR], "doubts": [POOR], "cameras": {}}
        calibration.save()
        for pose in range(1, 5):
            place = the_clinic().folder / calibration.folder / "calibration" / f"{pose:02d}"
            place.mkdir(parents=True)
            for number, camera in enumerate(CAMERAS):
                board_picture(place / f"{camera}.jpg", 10 * pose + number)
    return logins


if __name__ == "__main__":
    json.dump(main(Path(sys.argv[1])), sys.stdout)
