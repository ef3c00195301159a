"""The catalogue: the text of every notice, by its code. docs/reference/codes.md lists it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

Concern: TypeAlias = Literal["volume", "confirmation", "photographs"]


@dataclass(frozen=True, slots=True)
class Text:
    """Text of one code."""

    words: str
    """A template. ``{of}`` and ``{on}`` are the breasts concerned, ``{about}`` the cameras or pairs; other fields are
    the notice's values."""
    concern: Concern = "volume"
    """``confirmation``: shown by the state of a clinic's visit. ``photographs``: about the matching of photographs."""
    caution: str = ""
    """Text next to the volumes on the first page. Empty: none."""


FOLD_NOT_SEEN = (
    "The fold is hidden because the breast hangs over it. The interval is therefore wider, and no ptosis is "
    "stated. Lift the breast, let the patient lean forward, or scan from below as well."
)
_AWAY = "The points of pair {about} are {mm:.2f} ± {std_mm:.2f} mm away from those of the others."
_MOVED = "Cameras or body moved: see the warnings."
TEXTS: Mapping[str, Text] = MappingProxyType(
    {
        "skin-covered": Text(
            "{cm2:.0f} cm² of the skin inside the border of the {of} is a groove, as from a hand or a strap. It "
            "is measured because measure.bare_confirmed is set."
        ),
        "fold-not-seen": Text(f"The {{of}}: {FOLD_NOT_SEEN}", caution=FOLD_NOT_SEEN),
        "body-size-rare": Text(
            "The body is {size} for an adult: {lengths}. Check the unit or the printed board: lengths × {factor:.2g} "
            "would be usual, volumes × {volume_factor:.2g}.",
            caution="The body is {size} for an adult. Check the unit, or the size of the printed board. See the "
            "warnings.",
        ),
        "body-size-unknown": Text(
            "The size could not be checked: neither the trunk's sides nor both nipples were found. Check the unit or "
            "the printed board."
        ),
        "solid-not-watertight": Text(
            "The closed solid of the {of} is not watertight. Do not use its volume.",
            caution="Do not use this volume: its solid is not watertight.",
        ),
        "upright-unknown": Text(
            "The trunk shows no plane of symmetry, so left and ahead are roughly those of the cameras. Results that "
            "depend on left and up are only as exact as the cameras are level."
        ),
        "upright-from-breasts": Text(
            "The trunk shows no plane of symmetry, so left is along the line between the breasts. Results that depend "
            "on left and up are only as exact as the cameras are level."
        ),
        "nipple-not-seen": Text(
            "No nipple was seen on the {on}. Lengths from this nipple are missing: mark it if there is one."
        ),
        "outline-not-used": Text(
            "No outline of the subject is used in the photographs of {about}: {reasons}. Everything near was "
            "matched there, and the largest connected surface was kept. It may include other objects. Check the "
            "surface, or draw {masks}."
        ),
        "outline-first": Text(
            "The subject's outline in the photograph of {about} is not known, so the background may have been matched. "
            "Draw {masks}, and run again before you calibrate again."
        ),
        "pairs-matched-less-well": Text(
            "Pairs measured the same skin {mm:.2f} mm apart (RMS), as if something had moved. But nothing moved: "
            "matching was less accurate, for example where pairs see the skin at a flat angle. Nothing was "
            "corrected; the interval includes this. More overlap of neighbouring pairs, or more texture, helps."
        ),
        "camera-turned": Text(
            "A camera turned after the calibration: {turns}. Calibrate again before the next capture."
        ),
        "camera-turned-probably": Text(
            "A camera turned after the calibration, probably {about}. Calibrate again before the next capture."
        ),
        "cameras-turned": Text(
            "Cameras turned after the calibration ({turns}). Calibrate again before the next capture."
        ),
        "cameras-and-body-moved": Text(
            "Cameras turned after the calibration ({turns}), and body or pairs moved by {mm:.2f} mm. Calibrate again, "
            "expose all cameras together."
        ),
        "body-moved": Text(
            "The body, or a pair of cameras as a whole, moved between the exposures of the pairs, most for pair "
            "{about}: {mm:.2f} mm. Expose all cameras together."
        ),
        "body-breathed": Text(
            "The body breathed or swayed between the exposures of the pairs, most for pair {about}: {mm:.2f} mm. "
            "Expose all cameras together."
        ),
        "motion-corrected": Text(
            f"{_AWAY} This was corrected: the pairs now agree to {{after_mm:.2f}} mm ({{before_mm:.2f}} mm before); "
            "the interval includes the rest.",
            caution=_MOVED,
        ),
        "motion-not-corrected": Text(
            f"{_AWAY} This was not corrected, and the pairs disagree by {{before_mm:.2f}} mm; the interval "
            "includes this.",
            caution=_MOVED,
        ),
        "motion-not-confirmed": Text(
            f"{_AWAY} This was not corrected, because no other comparison of the pairs confirms it. The pairs disagree "
            "by {before_mm:.2f} mm; the interval includes this.",
            caution=_MOVED,
        ),
        "motion-unexplained": Text(
            "Pairs still disagree by {mm:.2f} mm in a way that no motion of cameras or pairs explains, for "
            "example because an arm or a fold moved between exposures. The interval includes this. Expose all "
            "cameras together."
        ),
        "head-not-shown": Text(
            "The body does not show where its head is: left and right depend on how the cameras are mounted. "
            "Check that none is upside down.",
            caution="Left and right may be exchanged: the body does not show where its head is. See the warnings.",
        ),
        "sides-doubtful": Text(
            "Left and right may be exchanged: the mesh was inside out, like a mirror image. Compare a mole, the "
            "operated side or a tattoo with the patient. If they are exchanged, export the mesh again without "
            "mirroring. If they are right: --sides-checked.",
            caution="Left and right may be exchanged: compare a mole or the operated side. See the warnings.",
        ),
        "posture": Text("Posture: {posture}. Volumes of different postures are not to be compared."),
        "mesh-of-another-scanner": Text(
            "The mesh comes from another scanner of unknown accuracy. The interval uses the uncertainty "
            "of scale and surface that was entered, or 0.1 % and 0.1 mm."
        ),
        "breasts-fuller-above": Text(
            "The breasts are fuller towards the head than towards the feet. Check that left and right are not "
            "exchanged, and that the direction of the head is right (--head)."
        ),
        "mesh-unit-assumed": Text(
            "The mesh is assumed to be in {unit}, as the body's size shows. If it is in another unit, state it with "
            "--units when you measure or import the file."
        ),
        "mesh-unit-doubtful": Text(
            "The mesh is assumed to be in {unit}, as the body's size shows. It is {mm:.0f} mm long in {unit}, and "
            "would be {others}. If it is in another unit, state it with --units when you measure or import the file."
        ),
        "mesh-part-mirrored": Text(
            "A part of the mesh is mirrored in the file (negative scale). Compare left and right with the patient: a "
            "mole, the operated side or a tattoo."
        ),
        "mesh-parts-hidden": Text("Hidden parts of the file were not read."),
        "mesh-subdivided": Text(
            "The file asks for a smoothed surface (subdivision). The mesh was read without smoothing."
        ),
        "mesh-animated": Text("The file has an animation. The mesh was read at its first frame."),
        "mesh-seams-joined": Text("{pieces} pieces that touch were joined along their seams."),
        "mesh-pieces-removed": Text("{pieces} other pieces, {percent:.2g} % of the area, were removed."),
        "mesh-planes-removed": Text(
            "{pieces} other pieces, {percent:.2g} % of the area, were removed. Some are flat, like a wall or a floor."
        ),
        "mesh-lids-removed": Text("{cm2:.0f} cm² of flat lids were removed: a plane is not skin."),
        "mesh-inside-out": Text("The mesh was inside out: its faces were turned outwards."),
        "mesh-faces-turned": Text("Neighbouring faces pointed to opposite sides: all were turned outwards."),
        "mesh-holes-closed": Text(
            "Holes were closed: {holes}, up to {mm:.0f} mm wide, {cm2:.1f} cm² in all. The interval includes the "
            "uncertainty of this skin."
        ),
        "front-of-trunk": Text("Only the front of the trunk is measured and shown."),
        "scan-merged": Text(
            "Scan {number} was merged with the first one: {overlap_percent:.0f} % of its skin is in the first scan "
            "too; 95 % of that within {within_mm:.1f} mm; lengths {scale_percent:+.1f} %; standard uncertainty "
            "{std_mm:.2f} mm."
        ),
        "scan-fits-badly": Text(
            "Scan {number} fits worse than a scan in the same posture. The patient may have moved between the scans: "
            "compare the volumes with those of a single scan, or scan again."
        ),
        "no-breast": Text(
            "No breast was found on the patient's {side} side: nothing there stands out from the trunk all around. If "
            "there is a breast, draw its boundary."
        ),
        "no-breast-low": Text(
            "No breast was found on the patient's {side} side: the highest place there stands out {top_mm:.0f} mm from "
            "the skin around it, and {mean_mm:.0f} mm on average. That is a chest's form, not a breast's. If there is "
            "a breast, draw its boundary."
        ),
        "breast-unclear": Text(
            "It is not clear whether a breast is missing on the patient's {side} side: nothing there stands out from "
            "the trunk all around. If there is a breast, draw its boundary."
        ),
        "breast-unclear-low": Text(
            "It is not clear whether a breast is missing on the patient's {side} side: the highest place there stands "
            "out {top_mm:.0f} mm from the skin around it, and {mean_mm:.0f} mm on average, like a chest. If there is a "
            "breast, draw its boundary."
        ),
        "breast-not-outlined": Text(
            "Nothing was measured on the patient's {side} side: what stands out there cannot be outlined (found "
            "{found}, expected {expected}). If there is a breast, draw its boundary."
        ),
        "breast-removed": Text("The patient's {side} breast is recorded as removed."),
        "volume-refused": Text(
            "The {side} breast was outlined, but its volume was refused ({subject}: found {found}, expected "
            "{expected}). Check its boundary, or draw a better one."
        ),
        "volume-uncertain": Text(
            "The {side} breast was outlined, but its volume was refused: the errors of the earlier stages make it "
            "uncertain by more than half."
        ),
        "boundary-not-confirmed": Text(
            "The automatic boundary of the {of} is not confirmed. Check it, and confirm it or draw a better one.",
            "confirmation",
        ),
        "boundaries-drawn-with-edit": Text(
            "Boundaries are drawn and confirmed with `mammometry edit`.", "confirmation"
        ),
        "cameras-imported": Text(
            "The cameras were imported. Their errors are not known and not included in the interval.",
            caution="The interval does not cover the cameras' errors.",
        ),
        "imported-view-rare": Text(
            "With the imported cameras, the shorter side of the field of view is {mm:,.0f} mm where the cameras' axes "
            "meet, which is rare. If the subject has another size, check the cameras' unit (units that would fit: "
            "{units})."
        ),
        "imported-baseline-rare": Text(
            "With the imported cameras, the two cameras of a pair are {mm:,.3g} mm apart, which is rare. Check the "
            "cameras' unit (units that would fit: {units})."
        ),
        "board-not-measured": Text(
            "The printed board was not measured. This alone makes each volume uncertain by ± {percent:.0f} %. "
            "Measure the length of its eleven columns, and enter it on the visit's page, or as edge_mm in board.toml."
        ),
        "board-measured-by-card": Text(
            "The bank card shows that the size of the printed board is {percent:+.2f} % off. All lengths were "
            "corrected, and are known to ± {uncertain_percent:.2f} % (95 %)."
        ),
        "body-moved-against-board": Text(
            "The body moved relative to the board between photographs, by about {moved_mm:.1f} mm. This was corrected: "
            "pairs disagree by {after_mm:.2f} mm instead of {before_mm:.2f} mm. Next time, have the patient hold her "
            "breath."
        ),
        "lens-changed-in-walk": Text(
            "Autofocus or stabilisation shifted the image between photographs, by about {px:.0f} px. This was "
            "corrected. Next time, lock the focus, and switch off stabilisation if the telephone allows it."
        ),
        "size-unusual": Text(
            "The surface has an unusual size: its longest side is {mm:,.0f} mm. Check that the sizes of target or "
            "cameras are in millimetres."
        ),
        "pair-disagrees": Text("Pair {about}: a vertical disparity of {px:.2f} ± {std_px:.2f} px.", "photographs"),
        "pair-moved": Text(
            "Pair {about}: a vertical disparity of {px:.2f} ± {std_px:.2f} px shows that a camera moved after the "
            "calibration, or that the photographs belong to another one.",
            "photographs",
        ),
        "texture-weak": Text(
            "Pair {about}: the texture is too weak for matching on {percent:.0f} % of the surface, which was "
            "not measured. Use more light, check the focus, or paint a pattern on a cast.",
            "photographs",
        ),
        "pair-little-matched": Text(
            "Pair {about} matched only {percent:.0f} % of the subject's silhouette.", "photographs"
        ),
        "subject-hidden": Text(
            "Something hides part of the subject in the photographs of {shares}. Skin that other pairs saw was "
            "kept. Skin that no pair saw is closed by the repair.",
            "photographs",
        ),
        "subject-not-separated": Text(
            "The subject was not separated from the background in {about}. Unmeasured parts of the surface have "
            "no limit there.",
            "photographs",
        ),
        "skin-not-measured": Text(
            "Only {percent:.0f} % of the skin of the {of} was measured. The elastic repair closed the rest.",
            caution="Only {percent:.0f} % of its skin was measured.",
        ),
        "postures-differ": Text(
            "The patient was {before} at the earlier date and {after} later. Volumes of different postures are not to "
            "be compared."
        ),
        "trunks-fit-badly": Text(
            "The trunks fit badly: 20 % of the skin around the breasts differs by more than {within_mm:.1f} mm. "
            "Check that both sessions show the same patient, with the same arm position and breathing."
        ),
        "trunks-lean-differently": Text(
            "The trunk leaned differently by {turned_deg:.0f}°. The breasts then hang differently, and "
            "the interval does not include this."
        ),
        "volume-at-one-date": Text("The {of} has a volume only at the {date} date, and is not compared."),
        "date-not-confirmed": Text(
            "The automatic boundaries of the {date} date are not confirmed. Check them with `mammometry edit`, "
            "and confirm them or draw better ones."
        ),
        "drawn-at-one-date": Text(
            "The boundaries of the {date} date were drawn by hand, the others found automatically. Part of the change "
            "may come from that. Draw both with `mammometry edit`. (No automatic boundaries were found: {found}.)"
        ),
        "drawn-at-one-date-replaced": Text(
            "The boundaries of the {date} date were drawn by hand, the others found automatically. They were measured "
            "again within automatic boundaries. For a better comparison, draw both with `mammometry edit`."
        ),
        "walls-differ": Text(
            "The dates used different chest walls ({walls}). Both were measured again with the wall “{wall}”."
        ),
        "dates-exchanged": Text("The sessions were given in the wrong order. The dates in their manifests were used."),
        "date-missing": Text("A session has no date. The first one given counts as the earlier one."),
        "measured-again": Text("The {date} session was measured again, because its settings were different."),
        "value-may-be-missing": Text('{column} is {value:g} for {row}: leave the row out if it means "no value".'),
        "column-constant": Text("Every value of {column} is {value:g}."),
        "unit-assumed": Text("Column {column} states no unit. {unit} was assumed, as in the other column."),
        "columns-differ": Text(
            "{measured} is typically {ratio:.3g} times {reference}: check that both have the same unit."
        ),
        "check-unreadable": Text("{file}, line {line}: not a valid entry of a check ({error}). It was skipped."),
        "photograph-unfitting": Text(
            "Pose {pose}: the photograph of {about} does not fit the others (off by {px:.2g} px) and was left out. "
            "Check that it is the right file, and was exposed together with the others.",
            "photographs",
        ),
        "photographs-exchanged": Text(
            "The photographs of {camera} in pose {pose} and of {other_camera} in pose {other_pose} are exchanged. They "
            "were left out.",
            "photographs",
        ),
        "photograph-of-another": Text(
            "Pose {pose}: the photograph of {camera} does not fit the others. It is the one of {other_camera} in pose "
            "{other_pose}. It was left out.",
            "photographs",
        ),
        "target-not-found": Text("Pose {pose}, {about}: {found}. {remedy}.", "photographs"),
        "target-inverse": Text(
            "The target is white on black in {photographs} of {total} photographs, which were inverted before reading. "
            "If it is printed black on white, these photographs are negatives."
        ),
        "cameras-not-together": Text(
            "Pose {pose}: {about} were not exposed together with the others, or the target moved between the exposures "
            "({mm:.3f} mm and {deg:.4f}°; {px:.2f} px on the target, {sigma:.0f} standard errors).",
            "photographs",
        ),
        "camera-not-together": Text(
            "Pose {pose}: {about} was not exposed together with the others, or moved in this pose alone ({mm:.3f} mm "
            "and {deg:.4f}°; {px:.2f} px on the target, {sigma:.0f} standard errors). Remove this photograph.",
            "photographs",
        ),
        "camera-moved": Text(
            "Camera {about} moved before pose {pose}, by {mm:.3f} mm and {deg:.4f}° ({px:.2f} px on the target, "
            "{sigma:.0f} standard errors). Do not use the poses before and after together: points would be "
            "{effect_mm:.2f} mm off.",
            "photographs",
        ),
        "not-converged": Text("The calibration's adjustment did not converge in {iterations} iterations."),
        "points-left-out": Text(
            "Pose {pose}: {points} of {total} points of {about} were left out as outliers.", "photographs"
        ),
        "photograph-blurred": Text(
            "Pose {pose}: points of {about} are measured only to {px:.2f} px, others to {typical_px:.2f} px. The "
            "photograph may be blurred, shaken or badly lit.",
            "photographs",
        ),
        "points-shifted": Text(
            "Pose {pose}: all points that {about} saw are shifted together by {sigma:.0f} standard errors (limit "
            "{limit:.0f}). A camera or the target moved, or the target bent.",
            "photographs",
        ),
        "focal-length-uncertain": Text(
            "The focal length of {about} is known only to {percent:.3f} % (limit {limit_percent:.2f} %) from {views} "
            "views. That is {mm:.2f} mm in depth. Add poses, and tilt the target more."
        ),
        "lens-little-covered": Text(
            "The target covered only {percent:.0f} % of the photographs of {about}. Add poses there."
        ),
        "space-little-covered": Text(
            "The target was shown in only {percent:.0f} % of the space that the pairs see. Hold it also nearer, "
            "farther and to the sides, where skin will be."
        ),
        "pixels-not-square": Text(
            "The pixels of {about} are {ratio:.3f} times as high as wide, but cameras have square pixels. The target "
            "or the photographs were stretched, or two sizes in [target] contradict each other."
        ),
        "pair-without-target": Text("Pair {about}: its cameras never saw the target in the same pose."),
        "pair-reconstruction-error": Text(
            "Pair {about} reconstructs the target to {mm:.2f} mm RMS (limit {limit_mm} mm)."
        ),
        "pair-scale-error": Text(
            "Pair {about} reconstructs the target {percent:+.3f} % too large, {volume_percent:+.2f} % in volume."
        ),
        "expected-error": Text(
            "The cameras' uncertainty moves measured points by {mm:.3f} mm RMS (worst pair: {about}, good up to "
            "{good_mm} mm)."
        ),
        "expected-error-large": Text(
            "The cameras' uncertainty moves measured points by {mm:.3f} mm RMS (worst pair: {about}, good up to "
            "{good_mm} mm), refused above {limit_mm} mm. Add poses."
        ),
        "residuals": Text(
            "The residuals are {px:.3f} px RMS, {mm:.3f} mm at the target (good up to {good_mm} mm), which is {grade}."
        ),
        "residuals-large": Text(
            "The residuals are {px:.3f} px RMS, {mm:.3f} mm at the target (good up to {good_mm} mm), which is poor: "
            "blur, noise, or a board that is not as described."
        ),
        "no-pose-left-out": Text("No pose could be left out for a test, because each one is needed. Add poses."),
        "left-out-fit": Text(
            "As a test, poses were left out of the adjustment. They fit to {px:.3f} px, {ratio:.2f} times as far as "
            "the others and {excess:.2f} times as far as expected."
        ),
        "left-out-misfit": Text(
            "As a test, poses were left out of the adjustment. They fit to {px:.3f} px, {ratio:.2f} times as far as "
            "the others and {excess:.2f} times as far as expected (limit {limit}). Do not trust the cameras where no "
            "target was shown. Add poses."
        ),
        "target-view-rare": Text(
            "With target.{name} = {stated_mm:g} mm, the shorter side of the field of view is {mm:,.0f} mm where the "
            "target was held, which is rare. If the subject has another size, check that the target's sizes are in "
            "millimetres (values that would fit: {fits})."
        ),
        "target-baseline-rare": Text(
            "With target.{name} = {stated_mm:g} mm, the two cameras of a pair are {mm:,.3g} mm apart, which is rare. "
            "Check that the target's sizes are in millimetres (values that would fit: {fits})."
        ),
        "target-not-measured": Text(
            "The printed board was not measured. If it is 0.1 % too large, volumes are 0.3 % too large. Measure its "
            "edge, and enter edge_mm and edge_std_mm."
        ),
        "target-measured": Text(
            "The target was measured: sizes are known to {percent:.3f} %, volumes to {volume_percent:.2f} %."
        ),
        "board-stretched": Text(
            "The calibration shows a board that is {percent:.2f} % {longer} along its rows than [target] says, "
            "compared with its columns. Volumes may be {volume_percent:.1f} % off. Print it without scaling, the same "
            "both ways, and measure both edges."
        ),
        "board-bent": Text(
            "The calibration shows a board that is bent by {mm:.1f} mm. Fix it on a flat, stiff plate, so that it "
            "keeps its shape."
        ),
        "sentence": Text("{text}"),
    }
)
"""Code → its text, English. ``sentence`` is a warning of version 1.0, which stored sentences."""
