"""How the telephone was held is known from the board."""

import numpy as np
import pytest
from tests.unit.walk.test_pairs import looking

from mammometry.api.photos import mounting_by_board
from mammometry.geometry import Rig
from mammometry.measure.trunk.body import rig_frame


@pytest.mark.parametrize("roll_deg", [0.0, 90.0, 180.0, -90.0, 20.0])
def test_the_head_is_up_on_the_board_however_the_telephone_was_held(roll_deg: float) -> None:
    cameras = {f"{i}": looking(f"{i}", angle, roll_deg=roll_deg) for i, angle in enumerate((-40, -15, 10, 35))}
    rig = Rig(name="telephone", cameras=cameras, pair_names={})
    mounting = mounting_by_board(rig)
    left, up, ahead = rig_frame(rig, dict.fromkeys(cameras, mounting))
    # The board's frame: x along its rows (to the patient's left), y down, z away from its reader.
    assert up @ [0.0, -1.0, 0.0] > np.cos(np.deg2rad(25.0))
    assert ahead @ [0.0, 0.0, -1.0] > 0.9
    assert left @ [1.0, 0.0, 0.0] > 0.85
    assert (mounting == "upright") == (abs(roll_deg) < 45)
