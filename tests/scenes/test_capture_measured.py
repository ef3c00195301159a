"""From the button to the volume: a virtual rig is fired, and what it fired is measured and compared with truth."""

import json
import os

import pytest
from tests.unit.capture.virtual_capture import RIG_TOML

from mammometry.cli.main import run
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.session import write_session


@pytest.mark.slow
def test_a_fired_cast_has_its_true_volume(tmp_path, capsys):
    """At a fifth of the size. Casts are within half a per cent at a quarter of it (docs/measured.md); 1 % here."""
    rendered = tmp_path / "calibrated"
    made = write_session(rendered, SessionRecipe(subject="plaster_5", scale=0.2, poses=8))
    rig = tmp_path / "rig.toml"
    text = RIG_TOML.format(
        subject="model", backend="virtual", timeout_s=30, lines="", options=f'session = "{rendered}"'
    )
    rig.write_text(text)
    assert run(["capture", str(tmp_path / "s"), "--rig", str(rig), "--json"]) == 0
    fired = json.loads(capsys.readouterr().out)
    assert fired["accepted"], fired["checks"]
    os.rename(made.folder / "truth", tmp_path / "truth")  # measured without it
    assert run(["run", str(tmp_path / "s"), "-q"]) == 0
    assert run(["evaluate", str(tmp_path / "s"), "--truth", str(tmp_path / "truth"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    print(json.dumps(found)[:3000])
    raise AssertionError
