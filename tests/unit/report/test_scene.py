"""What the viewer gets is what was measured: the packed scene, unpacked by a plain twin of the viewer's own code."""

import base64
import json
import zlib
from typing import Any

import numpy as np
import pytest
import synthetic

from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.measure.shape.lengths import LinearMeasure
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.report.figures.shading import front_frame
from mammometry.report.models import thinned, viewer_scene, with_lengths
from mammometry.report.scene import Layer, ViewedSurface, ViewerScene, to_json
from mammometry.surface.repair.repair import Provenance


def buffer(packed: str, dtype: str) -> np.ndarray:
    return np.frombuffer(zlib.decompress(base64.b64decode(packed)), dtype)


def surface(table: dict[str, Any]) -> TriangleMesh:
    steps = buffer(table["positions"], "<u2").reshape(-1, 3)
    coded = buffer(table["faces"], "<u4").astype(np.int64)
    corners = np.cumsum(np.where(coded % 2, -(coded + 1) // 2, coded // 2))
    return TriangleMesh(
        vertices=np.array(table["low"]) + steps * np.array(table["step"]), faces=corners.reshape(-1, 3).astype(np.int32)
    )


def test_a_model_survives_the_journey() -> None:
    ball = synthetic.ball(4)
    values = np.linspace(-1.0, 1.0, len(ball.vertices)).astype(np.float32)
    values[7] = np.nan
    model = ViewedSurface(
        name="ball",
        title="A <ball>",
        mesh=ball,
        normals=ball.vertices / synthetic.RADIUS_MM,
        layers=(Layer(name="x", title="X", help=".", values=values, kind="diverging", unit="mm", limits=(-0.5, 0.5)),),
    )
    text = to_json(ViewerScene(models=(model,), world_from_view=Transform.identity()))
    assert "<" not in text  # it stands inside a script element
    table = json.loads(text)["models"][0]
    back = surface(table)
    assert np.array_equal(back.faces, ball.faces)
    # Half a step of the 16-bit grid over 120 mm.
    assert np.abs(back.vertices - ball.vertices).max() <= 0.5 * 120 / 65535 * 1.001
    normals = buffer(table["normals"], "i1").reshape(-1, 3) / 127
    assert np.abs(normals - model.normals).max() <= 0.5 / 127 * 1.001
    coded = buffer(table["layers"][0]["values"], "<u2")
    assert coded[7] == 65535
    assert (coded[0], coded[-1]) == (0, 65534)  # clipped at the scale's ends
    inside = np.isfinite(values) & (np.abs(values) < 0.5)
    assert np.abs(-0.5 + coded[inside] / 65534 - values[inside]).max() < 1 / 65534


def test_thinning_keeps_the_shape() -> None:
    ball = synthetic.ball(6)
    small, origin = thinned(ball, 5000)
    assert len(small.faces) <= 5000
    assert small.is_watertight()
    # A chord of a 5000-triangle sphere of 60 mm radius sags by 0.05 mm; quadrics balance that about zero.
    assert np.abs(np.linalg.norm(small.vertices, axis=1) - synthetic.RADIUS_MM).max() < 0.1
    assert np.linalg.norm(ball.vertices[origin] - small.vertices, axis=1).max() < 2.0
    same, origin = thinned(ball, len(ball.faces))
    assert same is ball
    assert np.array_equal(origin, np.arange(len(ball.vertices)))


def test_both_breasts_are_shown_side_by_side_and_the_right_one_is_mirrored() -> None:
    ball = synthetic.ball(4)
    measured = [synthetic.measurement("left"), synthetic.measurement("right")]
    scene = viewer_scene(front_frame(synthetic.rig()), synthetic.repaired(ball), synthetic.textured(ball), measured)
    assert [model.name for model in scene.models] == ["whole", "left", "right"]
    assert scene.comparisons[0][1:] == ("left", "right")
    whole, left, right = scene.models
    assert [layer.name for layer in whole.layers] == ["provenance", "error"]
    assert len(whole.layers[0].categories) == len(Provenance)
    assert whole.wall is not None
    assert len(whole.curves) == 2
    for model in (left, right):  # a mirrored mesh must not be inside out
        centre = model.mesh.vertices.mean(axis=0)
        assert np.einsum("ij,ij->i", model.mesh.vertices - centre, model.normals).mean() > 0


def test_the_difference_in_shape_is_drawn_on_both_breasts_at_one_scale() -> None:
    ball = synthetic.ball(4)
    left, right = synthetic.measurement("left"), synthetic.measurement("right")
    n = len(left.closed.vertices)
    sides = Symmetry(
        plane_point_world=np.array([50.0, 0.0, 0.0]),
        plane_normal_world=np.array([1.0, 0.0, 0.0]),
        plane_sigma_mm=1.0,
        trunk_scatter_mm=1.0,
        left_from_mirrored=Transform.from_rotation_vector(np.zeros(3), np.array([0.0, 3.0, 0.0])),
        shift_mm=np.array([0.0, 3.0, 0.0]),
        turn_deg=0.0,
        difference_cc=0.0,
        difference_interval_cc=(-60.0, 60.0),
        ratio=1.0,
        rms_mirrored_mm=2.0,
        rms_mm=1.0,
        left_mm=np.full(n, 4.0),
        right_mm=np.full(n, -4.0),
    )
    scene = viewer_scene(
        front_frame(synthetic.rig()), synthetic.repaired(ball), synthetic.textured(ball), (left, right), symmetry=sides
    )
    _, shown_left, shown_right = scene.models
    layers = [model.layers[-1] for model in (shown_left, shown_right)]
    assert [layer.name for layer in layers] == ["symmetry", "symmetry"]
    assert layers[0].limits == layers[1].limits == (-5.0, 5.0)  # 4, rounded up
    assert (layers[0].values == 4.0).all()
    assert (layers[1].values == -4.0).all()
    # The right breast lies where its mirror image was laid, not where a mirror in the middle of the view puts it.
    to_world = scene.world_from_view.apply
    middles = [to_world(model.mesh.vertices).mean(axis=0) for model in (shown_left, shown_right)]
    assert np.allclose(middles[1] - middles[0], [100.0 - 2 * middles[0][0], 3.0, 0.0], atol=0.5)


@pytest.mark.parametrize(
    ("change", "message"), [({"limits": (1.0, 1.0)}, "rise"), ({"kind": "category"}, "categories")]
)
def test_a_layer_that_cannot_be_drawn_is_refused(change: dict[str, Any], message: str) -> None:
    table: dict[str, Any] = {"name": "x", "title": "X", "help": ".", "kind": "sequential"} | change
    with pytest.raises(ValueError, match=message):
        Layer(values=np.zeros(3, np.float32), **table)


def test_a_comparison_of_models_that_are_not_there_is_refused() -> None:
    ball = synthetic.ball(2)
    model = ViewedSurface(name="ball", title="Ball", mesh=ball, normals=ball.vertices)
    with pytest.raises(ValueError, match="comparison"):
        ViewerScene(models=(model,), world_from_view=Transform.identity(), comparisons=(("Both", "ball", "bell"),))


def test_lengths_are_lines_between_their_landmarks_with_their_values() -> None:
    ends = ((60.0, 0.0, 0.0), (0.0, 0.0, 60.0))

    def length(name: str, along: float | None) -> LinearMeasure:
        return LinearMeasure(
            name=name, title=name, straight_mm=84.85, straight_sigma_mm=1.0, geodesic_mm=along,
            geodesic_sigma_mm=None if along is None else 1.4, ends_world=ends,
        )  # fmt: skip

    ball = synthetic.ball(4)
    bare = viewer_scene(front_frame(synthetic.rig()), synthetic.repaired(ball), synthetic.textured(ball), [])
    lengths = [length("N-N", 94.2), length("N-IMF left", 94.25), length("N-midline left", None)]
    scene = with_lengths(bare, lengths)
    whole = json.loads(to_json(scene))["models"][0]
    assert [each["words"] for each in whole["lengths"]] == [
        "84.8 ± 2.0 mm", "94.2 ± 2.7 mm along the skin", "84.8 ± 2.0 mm",
    ]  # fmt: skip
    back = scene.world_from_view.apply(np.array(whole["lengths"][0]["ends"]))
    assert back == pytest.approx(np.array(ends), abs=1e-3)
    assert len(whole["landmarks"]) == 2  # the three lengths share their ends
