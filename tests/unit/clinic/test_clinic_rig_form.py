"""A rig is described on a page: what is kept is a session.toml that the commands open."""

import tomllib
from pathlib import Path

import pytest
from tests.clinic_forms import filled, refused
from tests.unit.clinic.test_clinic_uploads import DEFINITION

from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.table import target_from_table
from mammometry.clinic import rig_history
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Calibration, Rig
from mammometry.clinic.roles import Role
from mammometry.io.manifest import TARGETS, read_manifest
from mammometry.io.session import Session

ENTERED = {
    "name": "Room 2",
    "pair0_name": "front", "pair0_left": "front left", "pair0_right": "front_right",
    "pair1_name": "floor", "pair1_left": "floor_left", "pair1_right": "floor_right",
    "mounting": "upside-down",
    "board": "charuco", "columns": "11", "rows": "8", "square_mm": "24", "marker_mm": "17.5",
    "dictionary": "DICT_5X5_100",
    "measured_squares": "10", "measured_mm": "240.6", "measured_std_mm": "0.1",
}  # fmt: skip


def enter(client, **changes):
    return client.post("/rigs/new/", filled(client, "/rigs/new/", **{**ENTERED, **changes}))


@pytest.mark.requirement("R-RIG-3")
@pytest.mark.parametrize("role", [Role.TECHNICIAN, Role.ADMINISTRATOR])
def test_what_is_entered_is_a_session_that_opens(client_of, tmp_path, role):
    client = client_of(role)
    assert enter(client).status_code == 302
    rig = Rig.objects.get()
    answer = client.get(f"/rigs/{rig.pk}/session.toml")
    (tmp_path / "session.toml").write_bytes(answer.content)
    session = Session.open(tmp_path)
    assert session.pair_names == {"front": ("front_left", "front_right"), "floor": ("floor_left", "floor_right")}
    assert set(session.manifest.rig.turned.values()) == {"upside-down"}
    board = target_from_table(session.manifest.target)
    assert isinstance(board, Board)
    assert board.edge_mm == pytest.approx(11 * 24.06)  # 240.6 mm over ten squares
    assert board.scale_std == pytest.approx(0.1 / 240.6)
    assert session.inputs().target == board


def test_a_plain_chessboard_that_is_not_measured_is_the_templates(client_of):
    unmeasured = dict.fromkeys(("measured_squares", "measured_mm", "measured_std_mm"), "")
    enter(client_of(Role.TECHNICIAN), board="chessboard", columns="10", rows="7", square_mm="25", **unmeasured)
    ours, template = Rig.objects.get().definition["target"], tomllib.loads(TARGETS["chessboard"])["target"]
    assert ours == template


@pytest.mark.parametrize(
    ("changes", "field", "value"),
    [
        ({"pair0_left": ""}, "pair0_left", ""),
        ({"pair0_left": "front_right"}, "__all__", "'front_right' twice"),
        ({"pair1_name": "front"}, "__all__", "'front'"),
        ({"pair0_left": "vorne/links"}, "__all__", "rig.pairs.1.left: "),
        ({f"pair{k}_{part}": "" for k in range(2) for part in ("name", "left", "right")}, "__all__", ""),
        ({"columns": "2"}, "columns", "3"),
        ({"columns": ""}, "columns", ""),
        ({"marker_mm": "25"}, "board", "marker_mm"),
        ({"dictionary": "DICT_4X4_50", "columns": "20", "rows": "20"}, "board", "200 markers"),
        ({"square_mm": "0.2", "marker_mm": "0.15"}, "board", "square_mm: found 0.2 mm"),
        ({"measured_mm": ""}, "measured_mm", ""),
        ({"measured_squares": "12"}, "measured_squares", "11 squares"),
        ({"measured_mm": "264"}, "measured_mm", "26.40 mm, 10.0%"),  # eleven squares, counted as ten
        ({"measured_mm": "233"}, "measured_mm", "23.30 mm, 2.9%"),
        ({"measured_mm": "nan"}, "measured_mm", ""),
        ({"name": ""}, "name", ""),
    ],
)
def test_what_makes_no_rig_is_refused_beside_its_field(client_of, changes, field, value):
    answer = enter(client_of(Role.TECHNICIAN), **changes)
    assert answer.status_code == 200
    assert set(refused(answer)) == {field}
    assert value in refused(answer)[field]
    page = answer.content.decode()
    assert 'value="front_right"' in page or all(not value for value in changes.values())  # nothing typed is lost
    assert not Rig.objects.exists()


def test_a_length_that_is_far_off_is_asked_for_once_more(client_of):
    client = client_of(Role.TECHNICIAN)
    assert enter(client, measured_mm="233").status_code == 200
    assert enter(client, measured_mm="233", anyway="1").status_code == 302
    assert Rig.objects.get().definition["target"]["edge_mm"] == pytest.approx(256.3)


def test_changing_one_thing_keeps_all_others(client_of, clinic):
    """Of a file's description also what the form has no field for."""
    client = client_of(Role.TECHNICIAN)
    target = {**DEFINITION["target"], "flatness_mm": 0.2, "edge_mm": 350.7, "edge_std_mm": 0.1}
    pairs = DEFINITION["rig"]["pairs"]
    definition = {
        "rig": {"name": "as built", "pairs": pairs, "mounting": {"front_left": "left"}},
        "target": target,
        "intrinsics": {"target": {"kind": "chessboard", "squares": [10, 7], "square_mm": 25.0}},
    }
    rig = Rig.objects.create(name="Room 1", definition=definition)
    path = f"/rigs/{rig.pk}/edit/"
    client.post(path, filled(client, path, note="By the window"))
    rig.refresh_from_db()
    assert (rig.note, rig.definition) == ("By the window", definition)
    client.post(path, filled(client, path, measured_squares="10", measured_mm="250.2"))
    rig.refresh_from_db()
    assert rig.definition["target"] == {**target, "edge_mm": pytest.approx(350.28), "edge_std_mm": pytest.approx(0.14)}
    surveyed = Rig.objects.create(
        name="Room 3",
        definition={
            **definition,
            "target": {"kind": "points", "points_mm": [[0.0, 0.0, float(k * 50)] for k in range(6)]},
        },
    )
    path = f"/rigs/{surveyed.pk}/edit/"
    client.post(path, filled(client, path, note="Lamp"))
    before = surveyed.definition
    surveyed.refresh_from_db()
    assert (surveyed.note, surveyed.definition) == ("Lamp", before)


def test_two_people_who_describe_one_rig_do_not_overwrite_each_other(client_of):
    rig = Rig.objects.create(name="Room 1", definition=DEFINITION)
    path, one, other = f"/rigs/{rig.pk}/edit/", client_of(Role.TECHNICIAN), client_of(Role.ADMINISTRATOR)
    stale = filled(one, path, square_mm="26")
    assert other.post(path, filled(other, path, square_mm="27", marker_mm="19")).status_code == 302
    answer = one.post(path, stale)
    assert answer.status_code == 409
    assert "square_mm" in answer.content.decode()
    rig.refresh_from_db()
    assert rig.definition["target"]["square_mm"] == 27


def test_the_size_of_the_print_is_asked_where_it_is_needed(client_of, clinic):
    client = client_of(Role.TECHNICIAN)
    rig = Rig.objects.create(name="Room 1", definition=DEFINITION)
    calibration = rig_history.new_calibration(rig, None)
    for page in (f"/rigs/{rig.pk}/", f"/calibrations/{calibration.pk}/"):
        assert f'href="/rigs/{rig.pk}/edit/#h-print"' in client.get(page).content.decode()
    path = f"/rigs/{rig.pk}/edit/"
    client.post(path, filled(client, path, measured_squares="14", measured_mm="351", measured_std_mm="0.1"))
    for page in (f"/rigs/{rig.pk}/", f"/calibrations/{calibration.pk}/"):
        assert "#h-print" not in client.get(page).content.decode()
    queue.enqueue(Calibration.objects.get(), None)  # the calibration that was begun before has the size
    assert read_manifest(Path(clinic.folder / calibration.folder / "session.toml")).target["edge_mm"] == 351.0


def test_the_board_is_drawn_from_what_is_typed(client_of):
    client = client_of(Role.TECHNICIAN)
    typed = {name: ENTERED[name] for name in ("board", "columns", "rows", "square_mm", "marker_mm", "dictionary")}
    answer = client.get("/rigs/board.svg", typed)
    assert answer.headers["Content-Type"] == "image/svg+xml"
    picture = answer.content.decode()
    board = target_from_table(
        {"kind": "charuco", "squares": [11, 8], "square_mm": 24.0, "marker_mm": 17.5, "dictionary": "DICT_5X5_100"}
    )
    assert picture.count("M") == len(board.sheet().rectangles)
    assert client.get("/rigs/board.svg", {**typed, "board": "chessboard"}).content.decode().count("M") == 44
    for changes in ({"columns": ""}, {"columns": "1e9"}, {"board": "<svg>"}, {"square_mm": "0"}, {"marker_mm": "30"}):
        assert client.get("/rigs/board.svg", {**typed, **changes}).status_code == 422
    assert client.get("/rigs/board.svg").status_code == 422


def test_others_describe_no_rig(client_of):
    rig = Rig.objects.create(name="Room 1", definition=DEFINITION)
    for role in (Role.CLINICIAN, Role.RESEARCHER):
        for page in ("/rigs/new/", f"/rigs/{rig.pk}/edit/", "/rigs/board.svg", f"/rigs/{rig.pk}/session.toml"):
            assert client_of(role).get(page).status_code == 403


def test_other_cameras_ask_for_another_calibration(client_of, clinic):
    client = client_of(Role.TECHNICIAN)
    rig = Rig.objects.create(name="Room 1", definition=DEFINITION)
    calibration = rig_history.new_calibration(rig, None)
    calibration.state, calibration.current = "done", True
    calibration.save()
    path = f"/rigs/{rig.pk}/edit/"
    levels = [
        one.level_tag for one in client.post(path, filled(client, path, note="x"), follow=True).context["messages"]
    ]
    answer = client.post(path, filled(client, path, square_mm="26"), follow=True)
    assert [one.level_tag for one in answer.context["messages"]] != levels
