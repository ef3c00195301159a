"""A whole session of a pair with one camera upside down gives the volume of the upright one."""

import json
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from mammometry.cli import main


@pytest.mark.slow
def test_a_pair_with_one_camera_upside_down_is_measured(
    tiny: Path, tiny_settings: Path, tiny_demo: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    for path in [*tiny.glob("calibration/*/front_left.*"), *tiny.glob("capture/front_left.*")]:
        with Image.open(path) as picture:
            picture.transpose(Image.Transpose.ROTATE_180).save(path.with_suffix(".png"))
        path.unlink()
    arguments = [str(tiny), "--settings", str(tiny_settings), "--json"]
    assert main.run(["calibrate", *arguments]) == 5
    assert 'rig.mounting = { front_left = "upside-down" }' in json.loads(capsys.readouterr().out)["error"]
    manifest = tiny / "session.toml"
    manifest.write_text(manifest.read_text().replace("[rig]\n", '[rig]\nmounting = { front_left = "upside-down" }\n'))
    assert main.run(["run", *arguments]) == 0
    table = json.loads(capsys.readouterr().out)
    assert table["volumes_cc"]["model"] == pytest.approx(tiny_demo["volumes_cc"]["model"], rel=0.005)
