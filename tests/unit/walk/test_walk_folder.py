"""What a folder of a walk holds: order of its files, formats that are not read, a board under another name."""

from types import SimpleNamespace

import numpy as np
import pytest
from board_walk import BOARD, FOCAL_PX, MIDDLE, SIZE_WH, save

from mammometry.api.photos import prepare_walk, read_board
from mammometry.api.walk_pictures import walk_files, walk_video
from mammometry.base.errors import BoardSizeError, CalibrationError, SessionError
from mammometry.calibration.targets.table import target_from_table
from mammometry.geometry import Camera, Transform
from mammometry.walk.region import TELEPHONE_BOARD
from mammometry.walk.stations import Stations


def names_of(folder):
    return [path.name for path in walk_files(folder).values()]


def test_files_are_in_the_order_of_their_numbers(tmp_path):
    """Neighbours in the walk are found by this order."""
    for name in ("photo (10).jpg", "photo (2).JPG", "photo (1).jpg", "IMG_10000.jpg", "IMG_9999.jpg"):
        (tmp_path / name).touch()
    expected = ["IMG_9999.jpg", "IMG_10000.jpg", "photo (1).jpg", "photo (2).JPG", "photo (10).jpg"]
    assert names_of(tmp_path) == expected


def test_pictures_in_other_formats_are_reported_unless_they_are_there_twice(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("1.dng", "2.WEBP", "3.avif"):
        (folder / name).write_bytes(b"x")
    save(folder / "1.JPG", np.zeros((30, 40, 3), np.uint8))
    assert names_of(folder) == ["1.JPG", "2.WEBP", "3.avif"]
    with pytest.raises(CalibrationError) as refused:
        prepare_walk(folder, tmp_path / "session")
    assert [detail.partition(":")[0] for detail in refused.value.details] == ["2.WEBP", "3.avif"]


def test_the_moving_part_of_an_edited_live_photo_is_no_video(tmp_path):
    for name in ("IMG_E0001.JPG", "IMG_0001.MOV", "IMG_0002.HEIC", "IMG_E0002.MOV"):
        (tmp_path / name).touch()
    assert walk_video(tmp_path) is None
    (tmp_path / "IMG_0003.MOV").touch()
    with pytest.raises(SessionError):
        walk_video(tmp_path)


def test_photographs_in_a_folder_below_are_named(tmp_path):
    (tmp_path / "100APPLE").mkdir()
    (tmp_path / "100APPLE" / "1.jpg").touch()
    with pytest.raises(SessionError) as refused:
        walk_files(tmp_path)
    assert str(tmp_path / "100APPLE") in refused.value.remedy
    with pytest.raises(SessionError) as refused:
        walk_files(tmp_path / "100APPLE" / "1.jpg")
    assert refused.value.found == "a file"


@pytest.mark.parametrize("name", ["board.toml.txt", "board (1).toml", "Board.TOML.txt", "session.toml"])
def test_a_board_under_another_name_is_not_ignored(tmp_path, name):
    (tmp_path / name).write_text("edge_mm = 250.0\n")
    with pytest.raises(SessionError) as refused:
        read_board(tmp_path)
    assert refused.value.expected == "board.toml"
    (tmp_path / name).rename(tmp_path / f"._{name}")  # of macOS
    assert read_board(tmp_path) == BOARD


def test_an_unknown_dictionary_is_refused_with_the_file(tmp_path):
    lines = {**TELEPHONE_BOARD, "dictionary": "DICT_5x5_100"}
    text = "\n".join(f"{name} = {list(v) if isinstance(v, tuple) else v!r}" for name, v in lines.items())
    (tmp_path / "board.toml").write_text(text)
    with pytest.raises(SessionError) as refused:
        read_board(tmp_path)
    assert str(tmp_path / "board.toml") in refused.value.subject


def stations_at(distance_mm, board):
    middle = board.points_target.mean(axis=0)
    camera = Camera(
        name="01",
        size_wh=SIZE_WH,
        matrix=np.array([[FOCAL_PX, 0, MIDDLE[0]], [0, FOCAL_PX, MIDDLE[1]], [0, 0, 1]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=np.eye(3), translation_mm=np.array([0, 0, distance_mm]) - middle),
    )
    calibration = SimpleNamespace(target_points=board.points_target, observations=SimpleNamespace(target=board))
    return Stations(calibration=calibration, expanded=SimpleNamespace(rig=SimpleNamespace(cameras={"01": camera})))


@pytest.mark.parametrize(("factor", "fitting"), [(0.1, "24 mm"), (10.0, "24 mm"), (1 / 25.4, "24 mm")])
def test_a_board_in_another_unit_is_refused(factor, fitting):
    """All lengths are as wrong as the board, the distance of the telephone as well."""
    sizes = {name: TELEPHONE_BOARD[name] * factor for name in ("square_mm", "marker_mm")}
    board = type(BOARD)(squares=BOARD.squares, dictionary=BOARD.dictionary, **sizes)
    stations = stations_at(600.0 * factor, board)
    with pytest.raises(BoardSizeError) as refused:
        stations.require_distance()
    assert refused.value.remedy.endswith(f"{fitting} would fit")
    assert np.isfinite(stations.plane_mm((132.0, 84.0)))
    stations_at(600.0, BOARD).require_distance()


def test_ten_of_eleven_columns_are_no_print():
    table = {**TELEPHONE_BOARD, "edge_std_mm": 0.2}
    assert target_from_table({**table, "edge_mm": 248.2}).edge_mm == pytest.approx(248.2)  # A4 on Letter
    with pytest.raises(SessionError):
        target_from_table({**table, "edge_mm": 240.0})
