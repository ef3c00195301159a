"""Bad input gets one sentence and its exit code, leaves earlier results intact, and a rerun continues."""

import hashlib
import json
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mammometry.cli import main


def snapshot(results: Path) -> dict[str, str]:
    """Digest of every result, hidden files left out."""
    return {
        path.relative_to(results).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(results.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    }


def missing_camera(session: Path) -> None:
    (session / "capture" / "front_right.jpg").unlink()


def unreadable_image(session: Path) -> None:
    (session / "capture" / "front_right.jpg").write_bytes(b"no picture")


def truncated_image(session: Path) -> None:
    path = session / "capture" / "front_right.jpg"
    path.write_bytes(path.read_bytes()[:-2000])


def truncated_calibration_image(session: Path) -> None:
    path = session / "calibration" / "00" / "front_right.jpg"
    path.write_bytes(path.read_bytes()[:-2000])


def wrong_size(session: Path) -> None:
    path = session / "capture" / "front_left.jpg"
    with Image.open(path) as image:
        image.resize((200, 150)).save(path)


def wrong_orientation(session: Path) -> None:
    path = session / "capture" / "front_left.jpg"
    exif = Image.Exif()
    exif[274] = 3
    with Image.open(path) as image:
        image.save(path, exif=exif, quality=95)


def wrong_pair_names(session: Path) -> None:
    change_manifest(session, '"front_left"', '"front_lefft"')


def too_few_poses(session: Path) -> None:
    for pose in ("02", "03", "04", "05", "06", "07"):
        shutil.rmtree(session / "calibration" / pose)


def malformed_manifest(session: Path) -> None:
    change_manifest(session, "[rig]", "[rig")


def unknown_key(session: Path) -> None:
    change_manifest(session, "[subject]", "[subject]\nweight_kg = 60")


def unknown_format(session: Path) -> None:
    change_manifest(session, "format = 1", "format = 7")


def unknown_dictionary(session: Path) -> None:
    change_manifest(session, "DICT_5X5_250", "DICT_5X5_251")


def swapped_pair(session: Path) -> None:
    change_manifest(session, 'left = "front_left", right = "front_right"', 'left = "front_right", right = "front_left"')


def exchanged_photographs(session: Path) -> None:
    left, right = (session / "capture" / f"{camera}.jpg" for camera in ("front_left", "front_right"))
    left.rename(session / "other.jpg")
    right.rename(left)
    (session / "other.jpg").rename(right)


def nothing_in_the_picture(session: Path) -> None:
    for camera in ("front_left", "front_right"):
        replace_by_grey(session / "capture" / f"{camera}.jpg")


def change_manifest(session: Path, old: str, new: str) -> None:
    path = session / "session.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def replace_by_grey(path: Path) -> None:
    with Image.open(path) as image:
        size = image.size
    Image.fromarray(np.full((size[1], size[0], 3), 90, np.uint8)).save(path, comment=path.stem)  # no two are one file


CASES = [
    (missing_camera, 3, "capture/front_right: found no photograph (but front_left)"),
    (unreadable_image, 4, "capture/front_right.jpg: found a file that is not an image"),
    (truncated_image, 4, "capture/front_right.jpg: found a truncated image"),
    (truncated_calibration_image, 4, "calibration/00/front_right.jpg: found a truncated image"),
    (wrong_size, 4, "capture/front_left.jpg: found 200 × 150 pixels, expected 450 × 300 pixels, as in calibration/00"),
    (wrong_orientation, 4, "capture/front_left.jpg: found EXIF orientation 3, expected 1"),
    (wrong_pair_names, 3, "Did you mean front_left?"),
    (too_few_poses, 3, "calibration: found 2 poses (00, 01), expected at least 3"),
    (malformed_manifest, 3, "session.toml: found invalid TOML"),
    (unknown_key, 3, "session.toml: subject.weight_kg: found an unknown key, expected only kind"),
    (unknown_format, 3, "session.toml: format: found 7, expected 1"),
    (unknown_dictionary, 3, "DICT_5X5_251"),
    (swapped_pair, 5, "front"),
    (exchanged_photographs, 6, "capture, front_left and front_right: found photographs that seem to be exchanged"),
    (nothing_in_the_picture, 6, "a uniform photograph"),
]


QUICK = (malformed_manifest, unknown_key, unknown_format, unknown_dictionary, truncated_calibration_image, swapped_pair)
"""What the tests of a session's files and of rectification show as well."""


@pytest.mark.parametrize(
    ("break_it", "code", "said"),
    [pytest.param(*case, id=case[0].__name__, marks=[pytest.mark.slow] if case[0] in QUICK else []) for case in CASES],
)
def test_bad_input(
    tiny_finished: Path,
    tiny_settings: Path,
    tiny_original: Path,
    capsys: pytest.CaptureFixture[str],
    break_it: Callable[[Path], None],
    code: int,
    said: str,
) -> None:
    results = tiny_finished / "results"
    before = snapshot(results)
    break_it(tiny_finished)
    assert main.run(["measure", str(tiny_finished), "--settings", str(tiny_settings), "--quiet"]) == code
    printed = capsys.readouterr()
    assert printed.out == ""
    assert said in printed.err
    assert printed.err.startswith("mammometry: ")
    assert printed.err.count("\n") == 1
    after = snapshot(results)
    # A job that looked at photographs and refused them shows what it saw.
    assert ("refused/refused.html" in after) == (code in (5, 6))
    assert {name: digest for name, digest in after.items() if not name.startswith("refused/")} == before
    # Put right again, there is nothing left to do, and the page of the refusal is gone.
    for part in ("capture", "calibration"):
        shutil.rmtree(tiny_finished / part)
        shutil.copytree(tiny_original / part, tiny_finished / part)
    shutil.copy(tiny_original / "session.toml", tiny_finished / "session.toml")
    assert main.run(["report", str(tiny_finished), "--settings", str(tiny_settings), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["made"] == []
    assert snapshot(results) == before


@pytest.mark.slow
def test_no_target_in_any_picture(
    tiny_finished: Path, tiny_settings: Path, tiny_original: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tiny_finished / "results"
    cameras, mesh = (
        (results / "calibrate" / "cameras.json").read_bytes(),
        (results / "surface" / "mesh.ply").read_bytes(),
    )
    for path in tiny_finished.glob("calibration/*/*.jpg"):
        replace_by_grey(path)
    arguments = [str(tiny_finished), "--settings", str(tiny_settings)]
    assert main.run(["calibrate", *arguments, "--json"]) == 5
    failure = json.loads(capsys.readouterr().out)
    assert failure["error"].startswith("calibration photographs: found no charuco target in any of 16 photographs")
    assert failure["exit_code"] == 5
    assert (results / "calibrate" / "cameras.json").read_bytes() == cameras
    assert (results / "surface" / "mesh.ply").read_bytes() == mesh
    assert main.run(["info", *arguments, "--json"]) == 0
    stages = json.loads(capsys.readouterr().out)["stages"]
    assert {stage: about["state"] for stage, about in stages.items()} == dict.fromkeys(stages, "stale")
    shutil.rmtree(tiny_finished / "calibration")
    shutil.copytree(tiny_original / "calibration", tiny_finished / "calibration")
    assert main.run(["calibrate", *arguments, "--json"]) == 0
    # What was seen is seen again; all that follows is still there.
    assert json.loads(capsys.readouterr().out)["made"] == [f"calibrate/observations/0{pose}" for pose in range(8)]


@pytest.mark.slow
def test_bad_calibration_photographs_are_left_out_and_named(
    tiny: Path, tiny_settings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mirrored picture is left out and named; with a copy beside it, too few are left, and both are why."""
    for pose in ("04", "05", "06", "07"):
        shutil.rmtree(tiny / "calibration" / pose)
    # Three poses of so small pictures leave a focal length less sure than is asked by default. That is not tested here.
    relaxed = ["--set", "calibration.quality.focal_std_refuse=0.01"]
    arguments = ["calibrate", str(tiny), "--settings", str(tiny_settings), "--json", *relaxed]
    mirrored = tiny / "calibration" / "01" / "front_left.jpg"
    with Image.open(mirrored) as image:
        image.transpose(Image.Transpose.FLIP_LEFT_RIGHT).save(mirrored, quality=95)
    assert main.run(arguments) == 0
    notices = json.loads(capsys.readouterr().out)["notices"]
    assert ["calibration/01/front_left"] in [notice["photographs"] for notice in notices]
    shutil.copy(tiny / "calibration" / "00" / "front_left.jpg", tiny / "calibration" / "03" / "front_left.jpg")
    assert main.run(arguments) == 5
    message = json.loads(capsys.readouterr().out)["error"]
    assert "camera front_left: found 1" in message
    assert "03/front_left" in message


def started(session: Path, settings: Path, *arguments: str, **options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "mammometry", *arguments, str(session), "--settings", str(settings), "-v"]
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **options)  # type: ignore[call-overload]


def stop_when(process: subprocess.Popen[str], line: str, number: signal.Signals) -> str:
    """Send a signal once the log says `line`; return what was said after it."""
    assert process.stderr is not None
    for said in process.stderr:
        if line in said:
            process.send_signal(number)
            break
    err = process.stderr.read()
    assert process.stdout is not None
    assert process.stdout.read() == ""
    process.wait(timeout=60)
    process.stderr.close()
    process.stdout.close()
    return err


def without(session: Path, *stages: str) -> Path:
    """The session without its results from the first of these stages on."""
    for stage in stages:
        shutil.rmtree(session / "results" / stage)
    return session


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "stage", "finished", "line"),
    [
        pytest.param(
            signal.SIGINT, "calibrate", "observations/00", "making calibrate/calibration", id="ctrl-c while calibrating"
        ),
        pytest.param(
            signal.SIGKILL,
            "surface",
            "range/front",
            "making surface/first",
            id="kill -9 while meshing",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            signal.SIGKILL,
            "calibrate",
            "observations/00",
            "making calibrate/calibration",
            id="kill -9 while calibrating",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            signal.SIGINT,
            "surface",
            "range/front",
            "making surface/first",
            id="ctrl-c while meshing",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_interrupted_runs_continue(
    tiny_finished: Path,
    tiny_settings: Path,
    capsys: pytest.CaptureFixture[str],
    number: signal.Signals,
    stage: str,
    finished: str,
    line: str,
) -> None:
    """A stage begins with what it needs, is stopped after its first results, and goes on from these."""
    stages = ("calibrate", "match", "surface", "measure", "report")
    tiny = without(tiny_finished, *stages[stages.index(stage) :])
    process = started(tiny, tiny_settings, stage)
    said = stop_when(process, line, number)
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert said.splitlines()[-1].startswith("mammometry: Interrupted: finished results are kept")
        assert "Traceback" not in said
    else:
        assert process.returncode == -signal.SIGKILL
    product = line.removeprefix("making ")
    arguments = [str(tiny), "--settings", str(tiny_settings), "--json"]
    assert main.run(["info", *arguments]) == 0
    stages = json.loads(capsys.readouterr().out)["stages"]
    kept = {
        f"{stage}/{name}"
        for stage, about in stages.items()
        for name, state in about["products"].items()
        if state["state"] == "current"
    }
    assert f"{stage}/{finished}" in kept
    assert product not in kept
    assert main.run([stage, *arguments]) == 0
    made = set(json.loads(capsys.readouterr().out)["made"])
    assert product in made
    assert not made & kept
    assert not [path for path in (tiny / "results").iterdir() if path.name.startswith((".writing", ".ready"))]


@pytest.mark.slow
def test_a_full_disk(tiny_finished: Path, tiny_settings: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tiny = without(tiny_finished, "match", "surface", "measure", "report")
    arguments = [str(tiny), "--settings", str(tiny_settings), "--json"]
    before = snapshot(tiny / "results" / "calibrate")

    def no_large_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    process = started(tiny, tiny_settings, "match", preexec_fn=no_large_files)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 9
    assert "room" in err.splitlines()[-1]
    assert snapshot(tiny / "results" / "calibrate") == before
    assert main.run(["match", *arguments]) == 0
    made = json.loads(capsys.readouterr().out)["made"]
    assert "match/disparity/front" in made
    assert not [name for name in made if name.startswith("calibrate/")]


def test_two_runs_at_once(tiny_finished: Path, tiny_settings: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from mammometry.io.results.store import Store

    with Store(tiny_finished / "results").taken():
        assert main.run(["run", str(tiny_finished), "--settings", str(tiny_settings), "-q"]) == 9
    assert "another run in progress" in capsys.readouterr().err


@pytest.mark.slow
def test_damaged_results_are_named_and_renewed(
    tiny_finished: Path, tiny_settings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tiny_finished / "results"
    before = snapshot(results)
    damaged = ["surface/mesh.ply", "surface/model.glb", "surface/range/front.tif", "measure/overview.png"]
    for name in damaged:
        data = bytearray((results / name).read_bytes())
        data[-1] ^= 1
        (results / name).write_bytes(data)
    arguments = [str(tiny_finished), "--settings", str(tiny_settings), "--json"]
    assert main.run(["verify", *arguments]) == 9
    found = json.loads(capsys.readouterr().out)
    assert sorted(each["file"] for each in found["damaged"]) == sorted(damaged)
    renewed = ["measure/previews", "surface/mesh", "surface/model", "surface/range/front"]
    assert (sorted(found["renewed"]), found["not_renewed"]) == (renewed, [])
    assert main.run(["info", *arguments]) == 0
    stages = json.loads(capsys.readouterr().out)["stages"]
    assert (stages["surface"]["state"], stages["surface"]["products"]["mesh"]["state"]) == ("damaged", "damaged")
    assert main.run(["report", *arguments]) == 0
    made = set(json.loads(capsys.readouterr().out)["made"])
    assert made - {"report/content", "report/report"} == set(
        renewed
    )  # the report says how long each stage took: that may have changed
    after = snapshot(results)
    changed = {name for name in after if after[name] != before[name] and not name.startswith("report/")}
    assert changed <= {f"{s}/provenance.json" for s in stages}
    assert main.run(["verify", *arguments]) == 0
