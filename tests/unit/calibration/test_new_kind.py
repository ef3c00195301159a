"""A new kind of target is one class and its finder: nothing else in the package needs to know it."""

import json
import tomllib
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from mammometry.base.errors import SessionError
from mammometry.calibration.detection.detect import detect
from mammometry.calibration.detection.finders import find
from mammometry.calibration.features.constellation import read_constellation
from mammometry.calibration.features.dots import measure_dots
from mammometry.calibration.features.lattice import find_dots
from mammometry.calibration.features.pixels import FoundPoints, grey_bytes, linear_luma
from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.pdf import target_pdf
from mammometry.calibration.targets.sheet import PrintedSheet
from mammometry.calibration.targets.table import target_from_table
from mammometry.calibration.targets.target import TARGETS
from mammometry.io.results.codecs import from_tree, to_tree
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.poses import draw_poses
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.rigs.targets import described, sees_target


@dataclass(frozen=True, slots=True, kw_only=True)
class ScatteredTarget(Board):
    """Dots beside the places of a grid, no two neighbourhoods alike; origin at the grid's first place."""

    may_be_cropped: ClassVar[bool] = True

    grid: tuple[int, int]
    step_mm: float
    dot_mm: float = 7.0

    @property
    def points_target(self):
        places = np.stack(np.meshgrid(*map(np.arange, self.grid)), axis=-1).reshape(-1, 2)
        shifts = np.random.default_rng(3).uniform(-0.3, 0.3, places.shape)
        return np.column_stack([(places + shifts) * self.step_mm, np.zeros(len(places))])

    @property
    def extent_mm(self):
        points = self.points_target[:, :2]
        return np.array([points.min(axis=0) - self.dot_mm / 2, points.max(axis=0) + self.dot_mm / 2])

    @property
    def edge_mm(self):
        return float(np.ptp(self.extent_mm[:, 0]))

    def sheet(self):
        points = self.points_target[:, :2]
        return PrintedSheet(
            extent_mm=self.extent_mm, discs=np.column_stack([points, np.full(len(points), self.dot_mm / 2)])
        )


@find.register(ScatteredTarget)
def find_scattered(target, photograph, search_width_px):
    dots = find_dots(grey_bytes(photograph), 0.08)
    readings = read_constellation(target.points_target, dots, photograph.size_wh)
    if len(readings) != 1:
        return None
    ids, camera = np.sort(readings[0].ids), readings[0].camera
    measured = measure_dots(
        linear_luma(photograph),
        lambda xy: camera.image(np.concatenate([xy, np.zeros((*xy.shape[:-1], 1))], axis=-1)),
        target.points_target[ids, :2],
        shape="disc",
        half_mm=target.dot_mm / 2,
        pitch_mm=(target.step_mm, target.step_mm),
    )
    ok = measured.ok
    return FoundPoints(ids=ids[ok], uv=measured.uv[ok], covariance_px2=measured.covariance_px2[ok])


@pytest.fixture
def kind(monkeypatch):
    monkeypatch.setattr(TARGETS, "_entries", dict(TARGETS._entries))
    TARGETS.add("scattered")(ScatteredTarget)
    return "scattered"


def test_before_it_is_registered_its_name_is_unknown():
    with pytest.raises(SessionError, match=r"'scattered', .*'charuco', 'chessboard'"):
        target_from_table({"kind": "scattered", "grid": [7, 5], "step_mm": 24.0})


def test_it_is_stored_under_its_name(kind):
    target = ScatteredTarget(grid=(7, 5), step_mm=24.0)
    tree = to_tree(target, {})
    assert tree["$value"] == "target:scattered"
    assert from_tree(json.loads(json.dumps(tree)), {}) == target


@pytest.mark.slow
def test_a_new_kind_is_read_printed_rendered_and_found(kind):
    target = target_from_table({"kind": kind, "grid": [7, 5], "step_mm": 24.0})
    assert target == ScatteredTarget(grid=(7, 5), step_mm=24.0)
    assert target.kind == kind

    # The manifest that a virtual session writes, and the measured print.
    text = "\n".join(f"{key} = {json.dumps(value)}" for key, value in described(target).items())
    assert target_from_table(tomllib.loads(text)) == target
    edge_mm = 1.01 * target.edge_mm
    measured = target_from_table({**described(target), "edge_mm": edge_mm, "edge_std_mm": 0.1})
    assert (measured.step_mm, measured.dot_mm) == pytest.approx((1.01 * 24.0, 1.01 * 7.0))

    assert b"Title (scattered)" in target_pdf(target, page="A3")

    rig = make_rig("reference:front", 0.2, 7)
    pictures, truth, film = {}, {}, Film()
    for pose, placed in draw_poses(rig, target, 1, 7).items():
        for name, camera in rig.cameras.items():
            assert sees_target(camera, placed, target)
            radiance = render_target(camera, placed, target, flashes(), background=film.stray_light)
            pictures[pose, name] = develop(radiance, film, name=name, seed=1, bits=8)
            truth[pose, name] = camera.project(placed.apply(target.points_target))
    observations = detect(pictures, target)
    assert len(observations.detections) == 2, observations.missed
    for seen in observations.detections:
        assert len(seen.ids) > 30
        error_px = np.linalg.norm(seen.uv - truth[seen.pose, seen.camera][seen.ids], axis=1)
        assert np.median(error_px) < 0.1
