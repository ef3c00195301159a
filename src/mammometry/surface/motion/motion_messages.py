"""What moved between calibration and photographs, in plain words."""

from __future__ import annotations

from collections.abc import Iterator

from mammometry.surface.motion.motion_test import Stillness

_MOST_PART, _LITTLE = 0.7, 0.35
"""Share of a displacement above which only the body moved, and below which only cameras did. Chosen by eye."""
_NAMED = 3  # cameras in a sentence, at most


def concerns(found: Stillness) -> Iterator[str]:
    """Sentences that a user must read beside the volume. None where nothing moved."""
    if not found.moved:
        return
    before_mm, after_mm = found.distance_mm
    worst = found.displaced[0]
    done = (
        f"That was corrected: the pairs now agree to {after_mm:.2f} mm ({before_mm:.2f} mm before)"
        if found.corrected
        else f"That was not corrected, and the pairs disagree by {before_mm:.2f} mm"
    )
    yield (
        f"{cause(found)} Pair {worst.pair} measured its points {worst.effect_mm:.2f} ± {worst.std_mm:.2f} mm away from "
        f"where the others do. {done}; the interval covers what is left."
    )
    if found.unexplained:
        yield (
            f"Pairs still disagree by {found.rest_mm:.2f} mm in a way that no motion of cameras or pairs explains, as "
            "when an arm or a fold moves between exposures. The interval covers it. Expose all cameras together."
        )


def cause(found: Stillness) -> str:
    """What moved, and what to do, in two sentences."""
    worst = found.displaced[0]
    share = worst.body_mm / worst.effect_mm if worst.effect_mm > 0 else 0.0
    named = ", ".join(f"{turn.camera} by {turn.turn_deg:.3f} ± {turn.std_deg:.3f}°" for turn in found.turns[:_NAMED])
    if found.alone in found.parameters.cameras:
        turned = f"after the calibration: {named}" if named else f"after the calibration, probably {found.alone}"
        return f"A camera turned {turned}. Calibrate again before the next capture."
    if share >= _MOST_PART or found.alone is not None:
        who = "The body breathed or swayed" if found.breathed else "The body, or a pair of cameras as a whole, moved"
        return (
            f"{who} between the exposures of the pairs, most for pair {worst.pair}: {worst.body_mm:.2f} mm. Expose all "
            "cameras together."
        )
    who = f"Cameras turned after the calibration ({named or 'which ones is not certain'})"
    if share > _LITTLE:
        return (
            f"{who}, and body or pairs moved by {worst.body_mm:.2f} mm. Calibrate again, expose all cameras together."
        )
    return f"{who}. Calibrate again before the next capture."


def summary(found: Stillness) -> str:
    """One line for the technician."""
    if not found.compared:
        return "not compared: no two pairs see the same skin"
    if not found.moved:
        return f"nothing moved; pairs agree to {found.distance_mm[0]:.3f} mm (RMS)"
    pairs = ", ".join(
        f"{displacement.pair} {displacement.effect_mm:.2f} ± {displacement.std_mm:.2f} mm"
        for displacement in found.displaced
    )
    return (
        f"{'put right' if found.corrected else 'not put right'}: {pairs}; pairs agree to {found.distance_mm[1]:.3f} mm"
    )
