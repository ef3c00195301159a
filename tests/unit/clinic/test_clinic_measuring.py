"""All parts of a clinic measure alike: with other settings a page would make a visit's results again."""

import ast
from pathlib import Path

import mammometry.clinic
from mammometry.clinic.config import SETTINGS_FILE, new_clinic
from mammometry.settings import Settings


def test_a_clinic_measures_by_its_own_settings(tmp_path: Path) -> None:
    config = new_clinic(tmp_path / "clinic", name="Any")
    assert config.measuring() == Settings()
    (config.folder / SETTINGS_FILE).write_text("[surface.extract]\ncube_mm = 2.5\n")
    assert config.measuring().surface.extract.cube_mm == 2.5


def test_nothing_opens_a_session_by_the_defaults() -> None:
    calls = [
        (path.name, call.lineno, len(call.args))
        for path in Path(mammometry.clinic.__file__).parent.rglob("*.py")
        for call in ast.walk(ast.parse(path.read_text()))
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "open_session"
    ]
    assert len(calls) >= 4
    assert not [call for call in calls if call[2] < 2]
