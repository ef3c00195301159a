"""Pictures of the counting lamps on a board."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.lamps import LAMPS, LampStrip
from mammometry.geometry import Array, Camera, Float64, Rig, Transform
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.sampling import net_offsets
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.poses import draw_poses

_FILM = Film()
_ABOVE_MM = 70.0  # height of the rig's centre above the lamps: half a picture is about 130 mm high there
_SAMPLES = 16  # rays per pixel: a lamp's edge is accurate to a few hundredths


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LampScene:
    """Scene with the board and the counting lamps."""

    board: Board
    """Board to which the strip is clamped."""
    lights: Float64[Array, "l 4"]
    """Flashes, rig frame."""
    strip: LampStrip = LAMPS
    lamp_light: float = 0.6
    """Radiance of a lamp that is always on; full scale is 1."""
    film: Film = _FILM
    """The sensor."""


def hold_lamps(rig: Rig, board: Board, strip: LampStrip = LAMPS) -> Transform:
    """Rig from board, placed so that the lamps are in all pictures.

    The board faces all cameras as well as possible, with a point above the lamps at the rig's centre. Markers outside a
    picture are not needed.

    Args:
        rig: cameras in the rig's frame, whose origin is its centre.
        board: board to which the strip is clamped.
        strip: the lamps.
    """
    facing = draw_poses(rig, board, 1, 0)["00"].rotation
    held = strip.places_mm(board).mean(axis=0) - np.array([0.0, _ABOVE_MM, 0.0])
    return Transform(rotation=facing, translation_mm=-facing @ held)


def render_lamps(
    camera: Camera, rig_from_board: Transform, scene: LampScene, begin_ms: float, exposure_ms: float, *, seed: int = 0
) -> Photograph:
    """Photograph of the board while its lamps count.

    Args:
        camera: camera in the rig's frame.
        rig_from_board: pose of the board.
        scene: board, lamps and light.
        begin_ms: start of the exposure after the counter's 0.
        exposure_ms: duration of the exposure.
        seed: seed of its noise.
    """
    board, strip, film = scene.board, scene.strip, scene.film
    picture = render_target(camera, rig_from_board, board, scene.lights, background=film.stray_light)
    places = strip.places_mm(board)
    shares = np.concatenate([[1.0], strip.lit_share(np.array([float(begin_ms)]), exposure_ms)[0], [1.0]])
    net = net_offsets(_SAMPLES)
    board_from_rig = rig_from_board.inverse()
    reach = strip.lamp_mm * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    for place, share in zip(places, shares, strict=True):
        uv = camera.project(rig_from_board.apply(place + reach))
        if not np.isfinite(uv).all():
            continue
        (left, top), (right, bottom) = np.floor(uv.min(axis=0)).astype(int), np.ceil(uv.max(axis=0)).astype(int) + 1
        left, top = max(left, 0), max(top, 0)
        right, bottom = min(right, picture.shape[1]), min(bottom, picture.shape[0])
        if left >= right or top >= bottom:
            continue
        v, u = np.mgrid[top:bottom, left:right]
        rays = board_from_rig.rotate(camera.rays_world((np.stack([u, v], axis=-1)[:, :, None] + net).reshape(-1, 2)))
        origin = board_from_rig.apply(camera.centre_world)
        hits = origin[:2] - rays[:, :2] * (origin[2] / rays[:, 2])[:, None]
        inside = (np.linalg.norm(hits - place[:2], axis=1) < 0.5 * strip.lamp_mm).reshape(*u.shape, -1).mean(axis=-1)
        picture[top:bottom, left:right] += (inside * scene.lamp_light * share).astype(np.float32)
    return develop(picture, film, name=camera.name, seed=seed)
