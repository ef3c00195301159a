"""Compiled laying flat of the skin, against plain NumPy."""

import numpy as np

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.trunk import skin_map
from mammometry.measure.trunk.skin_map import PIXEL_MM, dense_samples, lay_flat
from mammometry.measure.trunk.thorax import HEIGHT_WINDOW_MM, WIDEST_DEG, Thorax, Trunk, on_trunk


def turned_trunk(rng):
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return Trunk(frame=frame, origin=rng.normal(size=3) * 50, half_width_mm=150.0)


def test_each_pixel_has_the_bulge_of_its_innermost_skin():
    rng = np.random.default_rng(3)
    trunk = turned_trunk(rng)
    coefficients = np.concatenate([[110.0], rng.normal(size=26) * 5])
    thorax = Thorax(trunk=trunk, coefficients=coefficients, rms_mm=1.0)
    points = trunk.origin + rng.normal(size=(40_000, 3)) * [150.0, 200.0, 150.0] @ trunk.frame
    points[0] = trunk.origin  # on the axis
    relief = lay_flat(thorax, points)
    cylindrical = trunk.cylindrical(points)
    width, height = np.deg2rad(WIDEST_DEG) * trunk.half_width_mm, HEIGHT_WINDOW_MM
    keep = (np.abs(cylindrical[:, 0]) < width) & (np.abs(cylindrical[:, 1]) < height) & on_trunk(cylindrical, trunk)
    assert 1000 < keep.sum() < len(points) / 2
    flat, bulge = cylindrical[keep, :2], thorax.bulge_mm(points[keep])
    column, row = np.round((flat + np.array([width, height])) / PIXEL_MM).astype(int).T
    inner = np.full(relief.bulge_mm.shape, np.inf)
    np.minimum.at(inner, (row, column), bulge)
    limits = np.array([trunk.half_width_mm, width, height, 1.15 * trunk.half_width_mm])
    radius = coefficients.reshape(3, 9)
    found = skin_map.innermost(
        points, trunk.frame, trunk.origin, radius, limits, PIXEL_MM, np.array(relief.bulge_mm.shape)
    )
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(inner))
    np.testing.assert_allclose(found, inner, atol=1e-9)
    assert relief.known[np.isfinite(inner)].all()


def test_an_arm_comes_from_the_shoulder_and_a_breast_that_fell_aside_does_not():
    """Skin 1.15 half widths aside of a cylinder: up to the picture's top on one side, an island on the other."""
    trunk = Trunk(frame=np.eye(3), origin=np.zeros(3), half_width_mm=150.0)
    thorax = Thorax(trunk=trunk, coefficients=np.concatenate([[150.0], np.zeros(26)]), rms_mm=1.0)
    degrees, up = (each.ravel() for each in np.meshgrid(np.arange(-110, 110.1, 0.5), np.arange(-139, 139.1, 1.0)))
    arm = (np.abs(degrees - 80) < 20) & (up > 20)
    flank = (np.abs(degrees + 80) < 20) & (np.abs(up) < 50)
    radius = np.where(arm | flank, 190.0, 150.0)
    angle = np.deg2rad(degrees)
    relief = lay_flat(thorax, np.stack([radius * np.sin(angle), up, radius * np.cos(angle)], axis=1))
    places = np.stack([150.0 * angle, up], axis=1)
    within = relief.at(places, relief.arm.astype(float)) > 0.5
    inner = (degrees > 70) & (degrees < 96) & (up > 30)  # from 65° on so far aside; 5 mm count as seen
    assert within[inner].all()
    assert not within[~arm].any()
    assert not (relief.arm & relief.known).any()


def test_a_breast_that_reaches_further_aside_than_the_trunk_is_no_arm():
    """Up to 55 mm high, 30 to 85° aside on the left, up to the picture's top; an arm 40 mm high on the right."""
    trunk = Trunk(frame=np.eye(3), origin=np.zeros(3), half_width_mm=150.0)
    thorax = Thorax(trunk=trunk, coefficients=np.concatenate([[150.0], np.zeros(26)]), rms_mm=1.0)
    degrees, up = (each.ravel() for each in np.meshgrid(np.arange(-110, 110.1, 0.5), np.arange(-139, 139.1, 1.0)))
    shape = np.clip((degrees - 30) / 55, 0, 1)
    out_mm = np.where(up > -60, 55 * np.sin(np.pi * shape) ** 2, 0.0)
    arm = (np.abs(degrees + 80) < 20) & (up > 20)
    radius, angle = 150 + np.where(arm, 40.0, out_mm), np.deg2rad(degrees)
    relief = lay_flat(thorax, np.stack([radius * np.sin(angle), up, radius * np.cos(angle)], axis=1))
    beyond = (radius * np.sin(angle) > 1.15 * 150 + 5) & (up > -50)
    assert beyond.sum() > 1000
    places = np.stack([150.0 * angle, up], axis=1)[beyond]
    assert (relief.at(places, relief.known.astype(float)) > 0.5).all()
    assert np.abs(relief.at(places, relief.bulge_mm) - out_mm[beyond]).max() < 6.0  # the innermost of 2 mm
    held_aside = np.stack([150.0 * angle, up], axis=1)[arm & (degrees < -70) & (degrees > -96) & (up > 30)]
    assert (relief.at(held_aside, relief.arm.astype(float)) > 0.5).all()


def test_samples_are_the_middles_of_equal_parts_of_each_face():
    rng = np.random.default_rng(4)
    vertices = rng.uniform(0, 12, (30, 3))
    faces = np.array([rng.choice(30, 3, replace=False) for _ in range(40)], dtype=np.int32)
    mesh = TriangleMesh(vertices=vertices, faces=faces)
    samples = dense_samples(mesh)
    at = 0
    for a, b, c in vertices[faces]:
        n = int(np.ceil(max(np.linalg.norm(side) for side in (a - b, b - c, c - a)) / 1.5))
        own = samples[at : at + n * n]
        at += n * n
        v, w = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), (own - a).T, rcond=None)[0]
        np.testing.assert_allclose(a + np.outer(v, b - a) + np.outer(w, c - a), own, atol=1e-9)
        upright = np.isclose(v * n % 1, 1 / 3)
        assert np.isclose(v * n % 1, np.where(upright, 1 / 3, 2 / 3)).all()
        assert np.isclose(w * n % 1, np.where(upright, 1 / 3, 2 / 3)).all()
        assert upright.sum() == n * (n + 1) // 2
        assert (v + w < 1).all()
        assert len(np.unique(np.round(np.stack([v, w], axis=1), 6), axis=0)) == n * n
    assert at == len(samples)
