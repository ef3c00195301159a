"""The catalogue: the text of every notice, by its code. docs/reference/codes.md lists it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

from mammometry.base.notices import Level, Notice
from mammometry.measure.settings import NOT_TO_BE_COMPARED
from mammometry.report.figures.names import NAMES

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
            "{text}",
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
            "{text} Results that depend on left and up are only as exact as the cameras are level."
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
            "Pairs measured the same skin {mm:.2f} mm apart (RMS), as if something had moved. But nothing did: "
            "the pairs were matched less well, for example where they see the skin at a flat angle. Nothing was "
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
            f"{_AWAY} That was corrected: the pairs now agree to {{after_mm:.2f}} mm ({{before_mm:.2f}} mm before); "
            "the interval includes the rest.",
            caution=_MOVED,
        ),
        "motion-not-corrected": Text(
            f"{_AWAY} That was not corrected, and the pairs disagree by {{before_mm:.2f}} mm; the interval "
            "includes this.",
            caution=_MOVED,
        ),
        "motion-not-confirmed": Text(
            f"{_AWAY} That was not corrected, because no other comparison of the pairs confirms it, and the pairs "
            "disagree "
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
        "posture": Text(f"Posture: {{posture}}. {NOT_TO_BE_COMPARED}."),
        "mesh-of-another-scanner": Text(
            "The mesh comes from another scanner of unknown accuracy. The interval uses the uncertainty "
            "of scale and surface that was entered, or 0.1 % and 0.1 mm."
        ),
        "breasts-fuller-above": Text(
            "The breasts are fuller towards the head than towards the feet. Check that left and right are not "
            "exchanged, and that the direction of the head is right (--head)."
        ),
        "mesh-repaired": Text("{text}"),
        "no-breast": Text(
            "No breast was found on the patient's {side} side. {text} If there is a breast, draw its boundary."
        ),
        "side-not-measured": Text(
            "Nothing was measured on the patient's {side} side. {text} If there is a breast, draw its boundary."
        ),
        "boundary-not-confirmed": Text(
            "The automatic boundary of the {of} is not confirmed. Check it, and confirm it or draw a better one.",
            "confirmation",
        ),
        "boundaries-drawn-with-edit": Text(
            "Boundaries are drawn and confirmed with `mammometry edit`.", "confirmation"
        ),
        "calibration-doubtful": Text("Check the calibration. {text}"),
        "cameras-imported": Text(
            "The cameras were imported. Their errors are not known and not included in the interval.",
            caution="The interval does not cover the cameras' errors.",
        ),
        "imported-camera-doubtful": Text("{text}"),
        "board-not-measured": Text(
            "The printed board was not measured: this alone makes each volume uncertain by {percent:.0f} %. "
            "Measure the ruler on the print, and enter it in board.toml (edge_mm)."
        ),
        "body-moved-against-board": Text(
            "The body moved against the board between photographs, by about {moved_mm:.1f} mm. This was corrected: "
            "pairs disagree by {after_mm:.2f} mm instead of {before_mm:.2f} mm. Hold the breath next time."
        ),
        "size-unusual": Text(
            "The surface has an unusual size: {text}. Check that the sizes of target or cameras are in millimetres."
        ),
        "pair-disagrees": Text("Pair {about}: a vertical disparity of {px:.2f} ± {std_px:.2f} px.", "photographs"),
        "pair-moved": Text(
            "Pair {about}: a vertical disparity of {px:.2f} ± {std_px:.2f} px shows that a camera moved after the "
            "calibration, or that the photographs belong to another one.",
            "photographs",
        ),
        "texture-weak": Text(
            "Pair {about}: the texture is too weak for matching on {percent:.0f} % of the surface, which was "
            "left open. Use more light, focus, or paint a pattern on a model.",
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
        "board-photograph-doubtful": Text("{text}", "photographs"),
        "board-photograph-left-out": Text(
            "Pose {pose} of camera {about} was left out of the calibration: it differs from the others by {px:.1f} px.",
            "photographs",
        ),
        "postures-differ": Text(
            f"The patient was {{before}} at the earlier date and {{after}} later. {NOT_TO_BE_COMPARED}."
        ),
        "trunks-fit-badly": Text(
            "The trunks fit badly: 20 % of the skin around the breasts is more than {within_mm:.1f} mm apart. "
            "Check that both sessions show the same patient, with the same arm position and breathing."
        ),
        "trunks-lean-differently": Text(
            "The trunk leaned differently by {turned_deg:.0f}°. Breasts then hang differently, by more than the "
            "interval includes."
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
        "value-may-be-missing": Text("{column} is {value:g} for {row}: leave the row out if it stands for no value."),
        "column-constant": Text("Every value of {column} is {value:g}."),
        "unit-assumed": Text("Column {column} states no unit; {unit} was taken, as the other's."),
        "columns-differ": Text(
            "{measured} is typically {ratio:.3g} times {reference}: check that both have the same unit."
        ),
        "check-unreadable": Text("{file}, line {line}: no entry of a check ({error}); it is left out."),
        "sentence": Text("{text}"),
    }
)
"""Code → its text, English. ``sentence`` is a warning of version 1.0, which stored sentences."""


def words_of(notice: Notice) -> str:
    """The notice as text."""
    return _filled(TEXTS[notice.code].words, notice)


def concerns(notice: Notice, breast: str) -> bool:
    """Whether a notice is about a breast: about it by name, or about all."""
    return breast in notice.about or not set(notice.about) & NAMES.keys()


def caution_of(notice: Notice) -> str:
    """Text next to the volumes on the first page. Empty: none."""
    return _filled(TEXTS[notice.code].caution, notice)


def _filled(template: str, notice: Notice) -> str:
    names = [NAMES.get(name, name) for name in notice.about]
    return template.format(
        of=" and of the ".join(names),
        on=" and on the ".join(names),
        about=", ".join(notice.about),
        side=notice.about[0] if notice.about else "",
        **notice.values,
    )


def words_at(level: Level, notices: Iterable[Notice]) -> list[str]:
    """The notices of one level as text."""
    return [words_of(notice) for notice in notices if notice.level == level]


def in_json(notices: Iterable[Notice]) -> dict[str, list[Any]]:
    """Notices for programs, in one order: text under ``warnings``, codes and values under ``notices``."""
    listed = list(notices)
    return {"warnings": list(map(words_of, listed)), "notices": [notice.as_table() for notice in listed]}


def lines_of(notices: Iterable[Notice]) -> list[str]:
    """Notices as lines in a terminal."""
    return [f"{'Warning' if notice.level == 'warning' else 'note'}: {words_of(notice)}" for notice in notices]


_OF_1_0 = (
    ("Nobody has confirmed the automatic boundary", "boundary-not-confirmed"),
    ("Boundaries are drawn and confirmed with", "boundaries-drawn-with-edit"),
    ("Pose ", "board-photograph-doubtful"),
    ("Pair ", "pair-moved"),
    ("Something hides part", "subject-hidden"),
    ("The subject was not separated", "subject-not-separated"),
    ("Left and right may be exchanged: the mesh was inside out", "sides-doubtful"),
)
"""Beginnings of sentences stored by version 1.0 → their code. They are a file format, and no longer written."""


def code_of_1_0(sentence: str) -> str:
    """Code of a warning that version 1.0 stored as a sentence."""
    return next((code for begin, code in _OF_1_0 if sentence.startswith(begin)), "sentence")
