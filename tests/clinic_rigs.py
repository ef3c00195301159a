"""Seeds a clinic with a calibrated rig whose calibration has a poor photograph: ``python -m tests.clinic_rigs DIR``."""

import datetime
import json
import sys
from pathlib import Path
from typing import Any

CAMERAS = ("front_left", "front_right")
POOR = "pose 02: 9 of 88 points of front_left were left out as outliers"


def exchanged_check(rig: Any) -> str:
    """A daily check that was judged: the photographs of its two cameras are exchanged."""
    from PIL import Image
    from tests.board_pictures import board_picture

    from mammometry.clinic import rig_history
    from mammometry.clinic.intake.photographs import small_picture, thumbnail_path
    from mammometry.clinic.models import Upload
    from mammometry.clinic.site import the_clinic
    from mammometry.io.write import file_digest

    check = rig_history.new_check(rig, None)
    assert check is not None
    folder = the_clinic().folder / check.folder
    folder.mkdir(parents=True)
    for number, camera in enumerate(CAMERAS):
        path = board_picture(folder / f"{camera}.jpg", 90 + number)
        row = Upload.objects.create(
            check_of_day=check, camera=camera, name=path.name, size_bytes=path.stat().st_size,
            sha256=file_digest(path), state="placed",
        )  # fmt: skip
        with Image.open(path) as opened:
            small_picture(opened, thumbnail_path(row))
    check.figures = {"verdict": "refuse", "reasons": [], "cameras": {}, "unseen": [], "exchanged": list(CAMERAS)}
    check.verdict, check.passed = "The photographs are exchanged: put them right, and check again.", False
    check.save()
    return str(check.pk)


def rendered_visits(folder: Path, captures: Path) -> list[str]:
    """Two visits before a rig whose cameras are those of an independent renderer's captures."""
    import numpy as np
    from benchmarks.rendered import make_session
    from django.utils import timezone

    from mammometry.api.job import open_session
    from mammometry.capture.sessions import definition_of
    from mammometry.clinic import rig_history
    from mammometry.clinic.models import Patient, Rig, Visit
    from mammometry.clinic.site import the_clinic
    from mammometry.geometry.camera import Camera
    from mammometry.geometry.transform import Transform
    from mammometry.io.cameras.own import cameras_table
    from mammometry.io.manifest import read_manifest

    session = make_session(captures, "torso", folder.parent / "rendered")
    rig = Rig.objects.create(name="Room 8", definition=definition_of(read_manifest(session / "session.toml")))
    calibration = rig_history.new_calibration(rig, None)
    true = json.loads((captures / "truth" / "cameras.json").read_text())["cameras"]
    cameras = {
        name: Camera(
            name=name,
            matrix=np.array(about["K"]),
            distortion=np.array(about["dist"]),
            size_wh=(1126, 750),
            camera_from_world=Transform(rotation=np.array(about["R"]), translation_mm=np.array(about["t"])),
        )
        for name, about in true.items()
    }
    place = the_clinic().folder / calibration.folder
    (place / "cameras.json").write_text(json.dumps(cameras_table(cameras)))
    open_session(place, the_clinic().measuring()).calibrate()
    calibration.state, calibration.current = "done", True
    calibration.figures = {"verdict": "pass", "reasons": [], "cameras": {name: {} for name in cameras}}
    calibration.save()
    patient = Patient.objects.create(family_name="Meier", given_name="Eva", record_number="C-1")
    visits = [
        Visit.objects.create(patient=patient, rig=rig, calibration=calibration, taken_at=timezone.now())
        for _ in range(2)
    ]
    return [str(visit.pk) for visit in visits]


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
    logins["check"] = exchanged_check(rig)
    if len(sys.argv) > 2:
        logins["visits"] = ",".join(rendered_visits(folder, Path(sys.argv[2])))
    return logins


if __name__ == "__main__":
    json.dump(main(Path(sys.argv[1])), sys.stdout)
