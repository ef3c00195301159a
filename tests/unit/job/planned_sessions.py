"""Sessions of every kind as inputs with made-up digests: enough to plan their products, too little to make one."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mammometry.geometry.mesh import TriangleMesh
from mammometry.job.inputs import Inputs
from mammometry.settings import Settings

CURVE = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, 60.0, 0.0]])
CAMERAS = ("front_left", "front_right", "floor_left", "floor_right", "back")


class Digests(dict[str, str]):
    """The digest of any input is its name in brackets."""

    def __missing__(self, name: str) -> str:
        return f"<{name}>"


@dataclass(frozen=True)
class Planned:
    """What a plan is laid out from."""

    inputs: Inputs
    settings: Settings = field(default_factory=Settings)


def inputs(kind: str, **changed: Any) -> Inputs:
    """Five cameras, four of them in pairs, and two poses of a target."""
    target: Any = "a target"  # a plan asks only whether there is one
    given: dict[str, Any] = {
        "rig_name": "five",
        "pair_names": {"front": ("front_left", "front_right"), "floor": ("floor_left", "floor_right")},
        "subject_kind": kind,
        "photographs": dict.fromkeys(CAMERAS),
        "target": target,
        "calibration_photographs": {(pose, camera): None for pose in ("b", "a") for camera in CAMERAS},
        "digests": Digests(),
    }
    return Inputs(**(given | changed))


def few(kind: str, **changed: Any) -> Inputs:
    """Three cameras, two of them a pair, and one pose: few products."""
    names: Any = dict.fromkeys(("front_left", "front_right", "back"))
    given: dict[str, Any] = {
        "pair_names": {"front": ("front_left", "front_right")},
        "photographs": names,
        "calibration_photographs": {("a", camera): None for camera in names},
    }
    return inputs(kind, **(given | changed))


def sessions() -> Mapping[str, Planned]:
    """Name → what is planned of it."""
    mask = np.zeros((2, 2), dtype=bool)
    wall = TriangleMesh(vertices=CURVE, faces=np.array([[0, 1, 2]], dtype=np.int32))
    lens: Any = "a lens"
    measured_points: Any = {("a", "back"): None}
    ready: Any = dict.fromkeys(CAMERAS)
    return {
        "cast": Planned(few("model", rim_radius_mm=1.5, wall=wall)),
        "surface": Planned(few("surface")),
        "torso": Planned(few("torso", masks={"back": mask}, priors={"back": lens})),
        "drawn": Planned(
            few(
                "torso",
                masks=dict.fromkeys(("front_left", "front_right", "back"), mask),
                boundaries={"left": CURVE},
                automatic=("right",),
                landmarks={"sternal_notch": CURVE[:1]},
                mounting={"back": "upside-down"},
                intrinsics_target="another target",
                intrinsics_photographs={"back": {("1", "back"): None}},
                measured_points=measured_points,
                scale_std=0.001,
            )
        ),
        "removed": Planned(few("torso", cameras=ready, removed=("left", "right"))),
        "by landmarks": Planned(
            few("torso", landmarks={"sternal_notch": CURVE[:1]}), Settings().overridden(["measure.boundary=landmarks"])
        ),
    }
