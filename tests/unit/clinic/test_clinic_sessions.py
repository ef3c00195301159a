"""Manifests out of a rig's definition, and photographs that several folders share."""

import datetime
import json

import pytest

from mammometry.base.errors import SessionError
from mammometry.capture.sessions import cameras_of, definition_of, make_session, manifest_text, share_calibration
from mammometry.io.manifest import RIGS, TARGETS, manifest_template, parse_manifest


@pytest.mark.parametrize("target", sorted(TARGETS))
@pytest.mark.parametrize("rig", sorted(RIGS))
def test_a_rig_goes_through_the_database_and_back(rig, target):
    first = parse_manifest(manifest_template(rig=rig, target=target))
    stored = json.loads(json.dumps(definition_of(first)))
    again = parse_manifest(manifest_text(stored, "torso", "P-ACD347", datetime.date(2026, 11, 23)))
    assert (again.rig, again.target, again.intrinsics) == (first.rig, first.target, first.intrinsics)
    assert (again.subject.kind, again.subject.id) == ("torso", "P-ACD347")
    assert again.date == datetime.date(2026, 11, 23)
    assert cameras_of(stored) == tuple(dict.fromkeys(c for p in first.rig.pairs for c in (p.left, p.right)))


def test_names_cannot_leave_their_quotes():
    table = {"rig": {"name": 'a"\nformat = 2 # \\', "pairs": [{"name": "p", "left": "a", "right": "b"}]}}
    assert parse_manifest(manifest_text(table, "model")).rig.name == table["rig"]["name"]


def test_what_is_no_rig_is_refused():
    for wrong in ({}, {"rig": {"name": "x", "pairs": []}}, {"rig": {"name": "x", "pairs": None}}):
        with pytest.raises(SessionError):
            manifest_text(wrong, "torso")


def test_calibration_photographs_are_shared_and_those_of_another_calibration_go(tmp_path):
    rig, visit = tmp_path / "rig", tmp_path / "visit"
    for pose in ("01", "02"):
        (rig / "calibration" / pose).mkdir(parents=True)
        (rig / "calibration" / pose / "a.jpg").write_bytes(pose.encode())
    make_session(visit, "format = 1\n")
    share_calibration(rig, visit)
    assert (visit / "calibration" / "01" / "a.jpg").samefile(rig / "calibration" / "01" / "a.jpg")
    other = tmp_path / "other"
    (other / "calibration" / "03").mkdir(parents=True)
    (other / "calibration" / "03" / "a.jpg").write_bytes(b"three")
    share_calibration(other, visit)
    found = sorted(path.relative_to(visit).as_posix() for path in (visit / "calibration").rglob("*.jpg"))
    assert found == ["calibration/03/a.jpg"]
    assert (rig / "calibration" / "01" / "a.jpg").read_bytes() == b"01"
