"""Sentences of the command line as pages say them."""

from __future__ import annotations

import re

_INSTEAD = (
    (r"with `mammometry edit`", "(a clinician, on the page of boundaries)"),
    (r"; compare\.refuse_mm sets the limit", ""),
    (r": --(?:head|ahead) -?[xyz], for example", ""),
    (r", or measure the largest alone with --largest", ""),
    (r"--units(?: mm, cm or m)?", "the unit of the mesh"),
    (r"--head", "the axis towards the head"),
    (r"--ahead", "the axis straight ahead"),
)


def on_pages(sentence: str) -> str:
    """A sentence with the clinic's pages and fields in place of commands and their options."""
    for pattern, words in _INSTEAD:
        sentence = re.sub(pattern, words, sentence)
    return sentence
