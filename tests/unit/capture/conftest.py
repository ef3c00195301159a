import shutil

import pytest
from tests.made_once import made_once
from tests.unit.capture.virtual_capture import make_pictures


@pytest.fixture(scope="session")
def pictures(tmp_path_factory):
    """A folder with the session ``calibrated``. Read only."""
    return made_once(tmp_path_factory, "capture", lambda folder: make_pictures(folder / "calibrated"))


@pytest.fixture
def place(pictures, tmp_path):
    """A place of one's own with the same session."""
    shutil.copytree(pictures / "calibrated", tmp_path / "calibrated")
    return tmp_path
