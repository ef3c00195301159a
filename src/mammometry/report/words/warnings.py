"""What a reader must know before the numbers, in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mammometry.base.sizes import subject_extent
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.quality import CalibrationQuality
from mammometry.matching import quality as match_quality
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.quality import MatchQuality
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.trunk.body import Body
from mammometry.measure.trunk.head import HEAD_NOT_SHOWN
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.content import sentence
from mammometry.report.figures.drawing.sides import NAMES
from mammometry.report.words.cautions import SKIN_MEASURED, skin_shares
from mammometry.surface.occlusion.occlusion import Occlusion
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_MATCHED = 0.6  # of a silhouette that a pair should match; flanks seen obliquely cost up to a third
_BLOCKED = 0.005  # of the subject in a photograph, hidden: less is a strap or a shadow; chosen by eye


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunResults:
    """Results of a run that may call for a warning."""

    quality: CalibrationQuality | None
    """Verdict on the calibration. None for imported cameras."""
    calibration: Calibration | None
    """With what was left out of it. None for imported cameras."""
    camera_doubts: Sequence[str] = ()
    """Sentences on what makes imported cameras doubtful."""
    shares: Mapping[str, float]
    """Pair → share of the subject's silhouette that was matched. It lacks pairs without silhouettes."""
    matching: Mapping[str, MatchQuality]
    """Pair → how well it was matched."""
    foregrounds: Mapping[str, Foreground]
    """Camera → its silhouette."""
    measurements: Sequence[VolumeMeasurement]
    """One a breast."""
    repaired: RepairedSurface
    """The surface, world frame."""
    blocked: Mapping[str, Occlusion] = field(default_factory=dict)
    """Camera → where something stands before the subject."""
    moved: Sequence[str] = ()
    """Sentences on what moved."""
    absent: Sequence[NoBreast] = ()
    """Sides of a torso without a measurement."""
    body: Body | None = None
    """The body's frame."""
    doubtful: Sequence[str] = ()
    """Breasts on which no nipple was seen."""
    unseparated: Mapping[str, str] = field(default_factory=dict)
    """Camera → why its silhouette was sought and is not used."""


def warnings(run: RunResults) -> Iterator[str]:
    """Warn of what the volumes rest on, the gravest first."""
    for measured in run.measurements:
        if not measured.watertight:
            yield f"The closed solid of the {NAMES[measured.name]} is not watertight. Do not use its volume."
    if run.body is not None and run.body.plane is None:
        yield f"{sentence(run.body.how)} What depends on left and up is only as exact as the cameras are level."
    if run.doubtful:
        yield (
            f"No nipple was seen on the {' and on the '.join(NAMES[name] for name in run.doubtful)}. What is measured "
            "from a nipple is left out there: pick it if there is one."
        )
    yield from run.moved
    if run.unseparated:
        reasons = "; ".join(dict.fromkeys(run.unseparated.values()))
        yield (
            f"No outline of the subject is used in the photographs of {', '.join(run.unseparated)}: {reasons}. "
            "Everything near was matched there, and the largest connected surface was taken. What else was near may be "
            "part of it. Look at the surface, or give masks."
        )
    if any(HEAD_NOT_SHOWN in measured.boundary_method for measured in run.measurements):
        yield (
            "The body does not show where its head is: left and right rest on how the cameras are mounted. Check that "
            "none is upside down."
        )


def run_concerns(run: RunResults) -> Iterator[str]:
    """Warn of what went less well in calibration and matching."""
    if run.quality is not None and run.quality.verdict != "pass":
        yield f"Check the calibration. {sentence(run.quality.reasons[0])}"
    for away in run.calibration.set_aside if run.calibration is not None else ():
        yield (
            f"Pose {away.pose} of camera {away.camera} was left out of the calibration: it is "
            f"{away.residual_px:.1f} px off the others."
        )
    if run.calibration is None:
        yield "The cameras were imported. Their errors are not known, and the interval does not cover them."
        yield from map(sentence, run.camera_doubts)
    extent = subject_extent(float(np.ptp(run.repaired.mesh.vertices, axis=0).max()))
    if not extent.is_usual():
        yield f"The surface is rare: {extent}. Check that the sizes of target or cameras are in millimetres."
    for name, judged in run.matching.items():
        yield from match_quality.concerns(name, judged)
    for name, share in run.shares.items():
        if share < _MATCHED:
            yield f"Pair {name} matched only {100 * share:.0f} % of the subject's silhouette."
    hidden = [
        f"{name} ({100 * occlusion.share:.0f} %)"
        for name, occlusion in run.blocked.items()
        if occlusion.share > _BLOCKED
    ]
    if hidden:
        yield (
            f"Something hides part of the subject in the photographs of {', '.join(hidden)}. The skin there was kept "
            "where other pairs saw it. Skin that no pair saw is closed by the repair."
        )
    blind = [name for name, known in run.foregrounds.items() if known.everything and name not in run.unseparated]
    if blind:
        yield (
            f"The subject was not separated from the background in {', '.join(blind)}. Nothing limits the surface "
            "where no pair measured it."
        )
    for measured in run.measurements:
        share = skin_shares(measured, run.repaired)[Provenance.MEASURED]
        if share < SKIN_MEASURED:
            yield (
                f"Only {100 * share:.0f} % of the skin of the {NAMES[measured.name]} was measured. The elastic repair "
                "closed the rest."
            )


def run_cautions(run: RunResults) -> Iterator[str]:
    """Warn of what changes every volume of a run."""
    if run.moved:
        yield "Cameras or body moved: see the warnings."
    if run.calibration is None:
        yield "The interval does not cover the cameras' errors."
