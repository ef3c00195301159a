"""The size of a print by a bank card on it."""

import numpy as np
import pytest
from board_walk import BOARD, arc, photograph, printed_sheet, save

from mammometry.api.photos import prepare_walk, read_walk
from mammometry.base.errors import BoardSizeError
from mammometry.base.photograph import Photograph
from mammometry.calibration.targets.card_field import CARD_MM, CARD_THICKNESS_MM, FIELD_MIDDLE
from mammometry.walk.bank_card import find_card
from mammometry.walk.stations import find_boards, stations_of

PRINTED = 0.99
"""Size of the print relative to the drawing."""


def pictures(*, grey=None, wall=0.6, thick_mm=CARD_THICKNESS_MM, count=12):
    """The board, printed 1 % small, in the lengths of the drawing; with a card 2 mm and 1 degree from its field."""
    card = None
    if grey is not None:
        card = {
            "middle": np.add(FIELD_MIDDLE, (1.5, -1.0)),
            "turn_rad": 0.02,
            "size_mm": np.array(CARD_MM) / PRINTED,
            "grey": grey,
            "wall": wall,
            "thick_mm": thick_mm,
        }
    sheet = printed_sheet()
    return [photograph(*station, sheet=sheet, card=card) for station in arc(count)]


def found_in(pixels):
    photographs = {f"{number:02d}": Photograph(name=str(number), pixels=of) for number, of in enumerate(pixels)}
    stations = stations_of(find_boards(photographs, BOARD))
    return find_card(stations.rig.cameras, photographs, BOARD, stations.plane_mm(FIELD_MIDDLE))


@pytest.mark.slow
@pytest.mark.requirement("R-PHOTO-3")
@pytest.mark.parametrize(
    ("grey", "wall"),
    [(0.3, 0.6), (0.75, 0.75), (0.02, 0.6)],
)
def test_a_card_gives_the_size_of_the_print(grey, wall):
    """Grey, as white as the paper, and as black as the ink."""
    found = found_in(pictures(grey=grey, wall=wall))
    assert found.scale == pytest.approx(PRINTED, abs=8e-4)
    assert found.std < 1e-3
    assert found.width_mm == pytest.approx(CARD_MM[0] / PRINTED, abs=0.06)
    assert found.height_mm == pytest.approx(CARD_MM[1] / PRINTED, abs=0.06)


@pytest.mark.slow
@pytest.mark.requirement("R-PHOTO-3")
def test_the_lengths_of_a_session_are_the_cards(tmp_path):
    for name, grey in (("with", 0.3), ("without", None)):
        (tmp_path / name).mkdir()
        for number, pixels in enumerate(pictures(grey=grey)):
            save(tmp_path / name / f"{number:02d}.jpg", pixels)
    walk = prepare_walk(tmp_path / "with", tmp_path / "session")
    assert walk == read_walk(tmp_path / "session")
    assert walk.card_scale == pytest.approx(PRINTED, abs=1e-3)
    assert walk.scale_std < 1e-3
    plain = prepare_walk(tmp_path / "without", tmp_path / "plain")
    assert plain.card_scale is None
    assert plain.scale_std == pytest.approx(0.01)
    text = 'kind = "charuco"\nsquares = [11, 7]\nsquare_mm = 24.0\nmarker_mm = 17.0\ndictionary = "DICT_5X5_100"\n'
    (tmp_path / "with" / "board.toml").write_text(f"{text}edge_mm = 264.0\nedge_std_mm = 0.2\n")
    with pytest.raises(BoardSizeError):
        prepare_walk(tmp_path / "with", tmp_path / "refused")
    (tmp_path / "with" / "board.toml").write_text(f"{text}edge_mm = 261.4\nedge_std_mm = 0.2\n")
    both = prepare_walk(tmp_path / "with", tmp_path / "both")
    assert both.card_scale == pytest.approx(1.0, abs=1e-3)
    assert both.scale_std < 6e-4
