"""Find the board in photographs that see it at too flat an angle for its markers to be recognised.

Photographs from the patient's sides show the outer sides of the breasts, and the board almost edge on. The positions of
neighbouring photographs are known. Image features shared with two of them give an approximate position, which shows
where the board is in the photograph. Its corners are then measured by comparison with the print.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from typing import TypeAlias

import numpy as np

from mammometry.base.machine.cores import map_in_threads
from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.detect import Detection, Observations, detection_of
from mammometry.calibration.detection.finders.printed_board import fit_print
from mammometry.calibration.features.board_map import LENS_TOLERANCE, fit_board_map
from mammometry.calibration.features.keypoints import Keypoints, keypoints, matched
from mammometry.calibration.features.pixels import linear_luma
from mammometry.calibration.features.pose_of_points import pose_of
from mammometry.calibration.judge.reconstruction import triangulate
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.geometry import Array, Camera, Float64, StereoPair
from mammometry.walk.stations import TELEPHONE, Stations

_NO_TARGET = "no-target"  # code of the photographs that are searched here; others are copies or mirrored
_REACH, _NEIGHBOURS = 3, 3
"""Largest distance of a neighbour in the order of the walk, and largest number of neighbours used."""
_WIDTH_PX, _MOST = 1000, 3000
"""Width of the reduced images, and largest number of features in each: they place the board to 1 px."""
_LEAST_ANGLE_DEG = 4.0  # least angle between the rays of two neighbours that triangulate a feature
_FIT_PX = 3.0  # largest reprojection error of a feature
_FEWEST_FEATURES = 15  # a pose has six unknowns
_LEAST_SHARE = 0.5  # least share of the corners: fewer may fit by chance, or the board is hidden
_NEARLY_ALL = 0.9  # share of the corners at which the search ends
_SHIFTS = (0.0, 1.0, -1.0, 2.0, -2.0)
"""Shifts from the expected position that are tried, px, along the board's narrow direction in the image."""


def tilted_boards(
    observations: Observations, stations: Stations, photographs: Mapping[str, Photograph]
) -> tuple[dict[str, Detection], dict[str, Camera]]:
    """Boards that were missed before, by photograph, and approximate cameras of all photographs.

    Args:
        observations: the board in the other photographs.
        stations: the telephone's positions from them.
        photographs: name → photograph, for all names in the observations.
    """
    target = observations.target
    if not isinstance(target, CharucoTarget):
        return {}, {}
    found: dict[str, Detection] = {}
    cameras = dict(stations.rig.cameras)
    missed = {miss.pose for miss in observations.missed if miss.code == _NO_TARGET}
    names = sorted({*cameras, *missed})
    waiting = [name for name in names if name in missed]
    near = [name for place, name in enumerate(names) if missed & {*names[max(0, place - _REACH) : place + _REACH + 1]}]
    found_in = map_in_threads(lambda name: keypoints(photographs[name], _WIDTH_PX, _MOST), near)
    features = dict(zip(near, found_in, strict=True))
    board = stations.calibration.target_points
    while waiting:
        reached = [name for name in waiting if len(_neighbours(name, names, cameras)) >= 2]
        if not reached:
            break
        # Photographs with most neighbours come first: they may become neighbours of others.
        name = max(reached, key=lambda name: len(_neighbours(name, names, cameras)))
        waiting.remove(name)
        around = _neighbours(name, names, cameras)
        camera = _placed(name, {other: cameras[other] for other in around}, features)
        detection = None if camera is None else _measured(photographs[name], camera, target, board)
        if camera is not None and detection is not None:
            cameras[name], found[name] = camera, detection
    return found, cameras


def _neighbours(name: str, names: list[str], cameras: Mapping[str, Camera]) -> list[str]:
    """Neighbouring photographs of the walk with known positions, nearest first."""
    place = names.index(name)
    near = sorted(
        (other for other in names[max(0, place - _REACH) : place + _REACH + 1] if other in cameras),
        key=lambda other: abs(names.index(other) - place),
    )
    return near[:_NEIGHBOURS]


def _placed(name: str, around: Mapping[str, Camera], features: Mapping[str, Keypoints]) -> Camera | None:
    """The camera of a photograph from features that it shares with two of its neighbours. None if too few agree.

    Args:
        name: the photograph.
        around: cameras of its neighbours, by name.
        features: of all photographs.
    """
    both = [*((other, name) for other in around), *combinations(around, 2)]
    found = map_in_threads(lambda both: matched(features[both[0]], features[both[1]]), both)
    matches = dict(zip(both, found, strict=True))
    shared = [
        _shared(around[one], around[other], matches[one, name], matches[one, other])
        for one, other in combinations(around, 2)
    ]
    places, uv = (np.concatenate(parts) for parts in zip(*shared, strict=True))
    lens = next(iter(around.values()))
    pose = pose_of(places, lens.normalised_from_pixels(uv), _FIT_PX / float(lens.matrix[0, 0]), _FEWEST_FEATURES)
    return None if pose is None else replace(lens, name=name, camera_from_world=pose)


_Matches: TypeAlias = tuple[Float64[Array, "m 2"], Float64[Array, "m 2"]]


def _shared(
    one: Camera, other: Camera, of_photograph: _Matches, of_other: _Matches
) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 2"]]:
    """World points of features seen in three photographs, mm, and their pixels in the one to be placed.

    Args:
        one: a neighbour's camera.
        other: another neighbour's camera.
        of_photograph: matches of `one` with the photograph to be placed, px.
        of_other: matches of `one` with `other`, px.
    """
    nothing = np.empty((0, 3)), np.empty((0, 2))
    (uv_one, uv), (uv_again, uv_other) = of_photograph, of_other
    rows = {tuple(at): row for row, at in enumerate(uv_again.tolist())}
    pairs = [(row, rows[at]) for row, at in enumerate(map(tuple, uv_one.tolist())) if at in rows]
    if not pairs:
        return nothing
    first, second = np.array(pairs).T
    places = triangulate(StereoPair(name=one.name, left=one, right=other), uv_one[first], uv_other[second])
    apart_deg = np.degrees(
        np.arccos(np.clip((one.rays_world(uv_one[first]) * other.rays_world(uv_other[second])).sum(axis=1), -1.0, 1.0))
    )
    good = apart_deg > _LEAST_ANGLE_DEG
    for camera, seen in ((one, uv_one[first]), (other, uv_other[second])):
        good &= camera.camera_from_world.apply(places)[:, 2] > 0
        good &= np.linalg.norm(camera.project(places) - seen, axis=1) < _FIT_PX
    return places[good], uv[first][good]


def _measured(
    photograph: Photograph, camera: Camera, target: CharucoTarget, board: Float64[Array, "n 3"]
) -> Detection | None:
    """The board's corners, searched where an approximate camera sees them. None if too few are found."""
    expected_uv = camera.project(board)
    inside = ((expected_uv > 2.0) & (expected_uv < np.array(camera.size_wh) - 3.0)).all(axis=1)
    ids = np.flatnonzero(inside)
    if len(ids) < target.least_points:
        return None
    linear, best = linear_luma(photograph), None
    spread = expected_uv[ids] - expected_uv[ids].mean(axis=0)
    narrow = np.linalg.svd(spread, full_matrices=False)[2][1]
    for shift_px in _SHIFTS:
        moved = expected_uv[ids] + shift_px * narrow
        found = fit_board_map(target.points_target[ids, :2], moved, tolerance_px=LENS_TOLERANCE * max(linear.shape))
        points = None if found is None else fit_print(linear, found[0], target, ids)
        if points is not None and (best is None or len(points.ids) > len(best.ids)):
            best = points
        if best is not None and len(best.ids) >= _NEARLY_ALL * len(ids):
            break
    if best is None or len(best.ids) < _LEAST_SHARE * len(ids):
        return None
    return detection_of(best, camera=TELEPHONE, pose=camera.name)
