"""Order of letters in bidirectional text (Unicode's bidirectional algorithm).

It supports first-strong isolates, which our sentences have around names (`base/letters`). Other embeddings, overrides
and isolates are ignored: names do not contain them.
"""

import re
import unicodedata
from collections.abc import Sequence
from itertools import groupby
from typing import TypeAlias, TypeVar

from mammometry.base.letters import END, ISOLATE

_Item = TypeVar("_Item")
_Kinds: TypeAlias = list[str]  # bidirectional class of each letter, changed rule by rule

_STRONG = {"L": 0, "R": 1, "AL": 1}
_ABSENT = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI", "BN"}
_NEUTRAL = {"B", "S", "WS", "ON"}
_BRACKETS = {
    "(": ")",
    "[": "]",
    "{": "}",
    "⟨": "⟩",
    "「": "」",
    "『": "』",
    "（": "）",
    "［": "］",
    "｛": "｝",
    "【": "】",
}
MIRRORED = str.maketrans({**_BRACKETS, **{last: first for first, last in _BRACKETS.items()}})
"""Mirrored brackets of right-to-left text, for `str.translate`."""
_ISOLATED = re.compile(f"{ISOLATE}([^{ISOLATE}{END}]*){END}")
_OBJECT = "\ufffc"  # replaces isolated text, which has no direction (rule BD9)
_DEEPEST = 63  # most open brackets, rule BD16


def is_right_to_left(text: str) -> bool:
    """Whether a text runs from right to left (rules P2 and P3).

    Decided by the first letter that has a direction, outside isolates.
    """
    kinds = map(unicodedata.bidirectional, _ISOLATED.sub("", text))
    return bool(next((_STRONG[kind] for kind in kinds if kind in _STRONG), 0))


def levels(line: str, base: int) -> list[int]:
    """Level of each letter: even from left to right, odd from right to left.

    Args:
        line: text without line breaks, in reading order.
        base: level of the paragraph, 0 or 1.
    """
    found = _with_isolates(line, base)
    is_end = True  # L1: spaces at the end of the line, and separators, have the paragraph's level
    for place in range(len(line) - 1, -1, -1):
        kind = unicodedata.bidirectional(line[place])
        is_end = kind in ("S", "B") or (is_end and (kind == "WS" or kind in _ABSENT))
        if is_end:
            found[place] = base
    return found


def _with_isolates(line: str, base: int) -> list[int]:
    found = _without_isolates(_ISOLATED.sub(lambda isolate: _OBJECT * len(isolate[0]), line), base)
    for isolate in _ISOLATED.finditer(line):
        first, last = isolate.span(1)
        above = found[first - 1] + 1
        found[first:last] = _without_isolates(isolate[1], above + (above % 2 != is_right_to_left(isolate[1])))
    return found


def _without_isolates(line: str, base: int) -> list[int]:
    classes = [unicodedata.bidirectional(letter) or "L" for letter in line]
    shown = [place for place, kind in enumerate(classes) if kind not in _ABSENT]
    kinds = [classes[place] for place in shown]
    _weak(kinds, base)
    _brackets(kinds, [line[place] for place in shown], [classes[place] for place in shown], base)
    _neutral(kinds, base)
    found = [base] * len(line)
    for place, kind in zip(shown, kinds, strict=True):
        found[place] = base + {"L": base % 2, "R": 1 - base % 2}.get(kind, 2 - base % 2)
    for place, kind in enumerate(classes):
        if kind in _ABSENT and place:
            found[place] = found[place - 1]
    return found


def reordered(items: Sequence[_Item], at: Sequence[int]) -> list[_Item]:
    """Items of one line in visual order from left to right (rule L2).

    Args:
        items: items in reading order.
        at: level of each item.
    """
    order = list(range(len(items)))
    odd = [level for level in at if level % 2]
    for level in range(max(at, default=0), min(odd, default=1) - 1, -1):
        turned: list[int] = []
        for is_turned, run in groupby(order, key=lambda place: at[place] >= level):
            places = list(run)
            turned += places[::-1] if is_turned else places
        order = turned
    return [items[place] for place in order]


def _weak(kinds: _Kinds, base: int) -> None:
    """Rules W1 to W7: marks, numbers and their neighbours."""
    before = strong = "LR"[base % 2]
    for place, kind in enumerate(kinds):  # W1, W2
        if kind == "NSM":
            kinds[place] = before
        before = kinds[place]
        if kinds[place] in _STRONG:
            strong = kinds[place]
        elif kinds[place] == "EN" and strong == "AL":
            kinds[place] = "AN"
    kinds[:] = ["R" if kind == "AL" else kind for kind in kinds]  # W3
    for place in range(1, len(kinds) - 1):  # W4
        left, kind, right = kinds[place - 1 : place + 2]
        if left == right and ((left == "EN" and kind in ("ES", "CS")) or (left == "AN" and kind == "CS")):
            kinds[place] = left
    for start, end in _runs(kinds, {"ET"}):  # W5
        if "EN" in (kinds[start - 1 : start] + kinds[end : end + 1]):
            kinds[start:end] = ["EN"] * (end - start)
    strong = "LR"[base % 2]
    for place, kind in enumerate(kinds):  # W6, W7
        if kind in ("ES", "ET", "CS"):
            kinds[place] = "ON"
        elif kind in _STRONG:
            strong = kind
        elif kind == "EN" and strong == "L":
            kinds[place] = "L"


def _brackets(kinds: _Kinds, letters: Sequence[str], classes: Sequence[str], base: int) -> None:
    """Rule N0: both brackets of a pair get one direction."""
    for first, last in _pairs(kinds, letters):
        inside = {_side(kind) for kind in kinds[first + 1 : last]} - {""}
        ours, other = "LR"[base % 2], "RL"[base % 2]
        if ours in inside:
            side = ours
        elif inside:
            before = next((_side(kind) for kind in reversed(kinds[:first]) if _side(kind)), ours)
            side = other if before == other else ours
        else:
            continue
        for place in (first, last):
            kinds[place] = side
            for after in range(place + 1, len(kinds)):
                if classes[after] != "NSM":
                    break
                kinds[after] = side


def _pairs(kinds: Sequence[str], letters: Sequence[str]) -> list[tuple[int, int]]:
    """Positions of matching brackets, sorted by the position of the first (rule BD16)."""
    opened: list[tuple[str, int]] = []
    found: list[tuple[int, int]] = []
    for place, letter in enumerate(letters):
        if kinds[place] != "ON":
            continue
        if letter in _BRACKETS:
            if len(opened) == _DEEPEST:
                return []
            opened.append((_BRACKETS[letter], place))
        for depth in range(len(opened) - 1, -1, -1):
            if opened[depth][0] == letter:
                found.append((opened[depth][1], place))
                del opened[depth:]
                break
    return sorted(found)


def _neutral(kinds: _Kinds, base: int) -> None:
    """Rules N1 and N2: neutral letters get the direction of both sides, or else the paragraph's."""
    for start, end in _runs(kinds, _NEUTRAL):
        before = _side(kinds[start - 1]) if start else "LR"[base % 2]
        after = _side(kinds[end]) if end < len(kinds) else "LR"[base % 2]
        kinds[start:end] = [before if before == after else "LR"[base % 2]] * (end - start)


def _side(kind: str) -> str:
    """Direction of a class for its neighbours. Numbers count as right-to-left. Empty if there is none."""
    return kind if kind == "L" else "R" if kind in ("R", "EN", "AN") else ""


def _runs(kinds: Sequence[str], wanted: set[str]) -> list[tuple[int, int]]:
    """First position, and position after the last, of each run of these classes."""
    found, start = [], 0
    for is_wanted, run in groupby(kinds, key=lambda kind: kind in wanted):
        end = start + len(list(run))
        if is_wanted:
            found.append((start, end))
        start = end
    return found
