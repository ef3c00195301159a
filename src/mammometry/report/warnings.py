"""What a reader must know before the numbers, in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

from mammometry.calibration.adjust.bundle import Calibration
from mammometry.calibration.judge.quality import CalibrationQuality
from mammometry.matching import quality as match_quality
from mammometry.matching.foreground import Foreground
from mammometry.matching.match import DisparityMap
from mammometry.measure.boundary.boundary import TO_BE_CONFIRMED
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.trunk.body import Body
from mammometry.measure.volume.volume import VolumeMeasurement
from mammometry.report.content import sentence, skin_shares
from mammometry.report.figures.sides import NAMES
from mammometry.surface.occluders import Blocked
from mammometry.surface.repair import Provenance, RepairedSurface

_MATCHED = 0.6  # of a silhouette that a pair should match; flanks seen obliquely cost up to a third
_SKIN_MEASURED = 0.8  # of a breast's skin, not closed by the elastic repair; chosen by eye
_BLOCKED = 0.005  # of the subject in a photograph, hidden: less is a strap or a shadow; chosen by eye


def warnings(
    *,
    quality: CalibrationQuality | None,
    calibration: Calibration | None,
    shares: Mapping[str, float],
    disparities: Mapping[str, DisparityMap],
    foregrounds: Mapping[str, Foreground],
    measurements: Sequence[VolumeMeasurement],
    repaired: RepairedSurface,
    blocked: Mapping[str, Blocked] = MappingProxyType({}),
    moved: Sequence[str] = (),
    absent: Sequence[NoBreast] = (),
    body: Body | None = None,
    doubtful: Sequence[str] = (),
) -> Iterator[str]:
    """Warn, the gravest first.

    Args:
        quality: verdict on the calibration; None for imported cameras.
        calibration: what was left out of it.
        shares: pair → share of the subject's silhouette that was matched.
        disparities: pair → what was matched.
        foregrounds: camera → its silhouette.
        measurements: one a breast.
        repaired: the surface.
        blocked: camera → where something stands before the subject.
        moved: sentences on what moved.
        absent: sides of a torso without a measurement.
        body: the body's frame.
        doubtful: breasts on which no nipple was seen.
    """
    for measured in measurements:
        if not measured.watertight:
            yield f"The closed solid of the {NAMES[measured.name]} is not watertight. Do not use its volume."
    yield from (unmeasured_words(side) for side in absent)
    if body is not None and body.plane is None:
        yield f"{sentence(body.how)} What depends on left and up is only as exact as the cameras are level."
    if doubtful:
        yield (
            f"No nipple was seen on the {' and on the '.join(NAMES[name] for name in doubtful)}. What is measured from "
            "a nipple is left out there: pick it with `mammometry edit` if there is one."
        )
    yield from moved
    unconfirmed = [NAMES[measured.name] for measured in measurements if TO_BE_CONFIRMED in measured.boundary_method]
    if unconfirmed:
        yield (
            f"Nobody has confirmed the automatic boundary of the {' and of the '.join(unconfirmed)}. Look at it with "
            "`mammometry edit`, and confirm it or draw a better one."
        )
    if quality is not None and quality.verdict != "pass":
        yield f"Check the calibration. {sentence(quality.reasons[0])}"
    for away in calibration.set_aside if calibration is not None else ():
        yield (
            f"Pose {away.pose} of camera {away.camera} was left out of the calibration: it is "
            f"{away.residual_px:.1f} px off the others."
        )
    if calibration is None:
        yield "The cameras were imported. Their errors are not known, and the interval does not cover them."
    for name, found in disparities.items():
        yield from match_quality.concerns(name, match_quality.assess(found))
    for name, share in shares.items():
        if share < _MATCHED:
            yield f"Pair {name} matched only {100 * share:.0f} % of the subject's silhouette."
    hidden = [f"{name} ({100 * each.share:.0f} %)" for name, each in blocked.items() if each.share > _BLOCKED]
    if hidden:
        yield (
            f"Something hides part of the subject in the photographs of {', '.join(hidden)}. The skin there was kept "
            "where other pairs saw it. Skin that no pair saw is closed by the repair."
        )
    blind = [name for name, known in foregrounds.items() if known.everything]
    if blind:
        yield (
            f"The subject was not separated from the background in {', '.join(blind)}. Nothing limits the surface "
            "where no pair measured it."
        )
    for measured in measurements:
        share = skin_shares(measured, repaired)[Provenance.MEASURED]
        if share < _SKIN_MEASURED:
            yield (
                f"Only {100 * share:.0f} % of the skin of the {NAMES[measured.name]} was measured. The elastic repair "
                "closed the rest."
            )


def unmeasured_words(side: NoBreast) -> str:
    """Warn of a side that was not measured."""
    return (
        f"{'Nothing was measured' if side.unclear else 'No breast was found'} on the patient's {side.name} side. "
        f"{sentence(side.why)} Look at the first picture, and draw the boundary with `mammometry edit` if there is "
        "a breast."
    )
