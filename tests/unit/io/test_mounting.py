"""How the cameras are mounted, as session.toml says it."""

import pytest

from mammometry.base.errors import SessionError
from mammometry.io.manifest import manifest_template, parse_manifest


def rig_with(mounting: str) -> str:
    text = manifest_template(rig="reference", target="charuco", subject="torso")
    return text.replace("[rig]\n", f"[rig]\nmounting = {mounting}\n")


def test_all_cameras_or_some_are_turned() -> None:
    assert parse_manifest(manifest_template(rig="reference", target="charuco")).rig.turned == {}
    every = parse_manifest(rig_with('"upside-down"')).rig.turned
    assert set(every.values()) == {"upside-down"}
    assert len(every) == 8
    some = parse_manifest(rig_with('{ floor_left = "left", floor_right = "upright" }')).rig.turned
    assert some == {"floor_left": "left"}


@pytest.mark.parametrize("mounting", ['"sideways"', '{ nobody = "left" }', "1"])
def test_what_is_no_mounting_is_refused(mounting: str) -> None:
    with pytest.raises(SessionError, match=r"session\.toml: rig"):
        parse_manifest(rig_with(mounting))
