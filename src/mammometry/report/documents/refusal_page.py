"""Page of a refused run, with what was seen."""

from __future__ import annotations

from collections.abc import Mapping

from mammometry.base.errors import MammometryError
from mammometry.base.identity import Identity
from mammometry.report.content import Fact, sentence
from mammometry.report.documents.pages import embed, render


def refusal_page(identity: Identity, error: MammometryError, pictures: Mapping[str, bytes]) -> str:
    """The refusal's parts, and the pictures made before it.

    Args:
        identity: whose photographs they are.
        error: the refusal.
        pictures: name → PNG with its caption, the most telling first.
    """
    return render(
        "refused.html.j2",
        identity=identity,
        subject=_heading(error.subject),
        details=(
            Fact(label="Found", value=error.found),
            Fact(label="Expected", value=error.expected),
        ),
        remedy=sentence(error.remedy),
        lines=[sentence(line) for line in error.details],
        pictures=[embed(png) for png in pictures.values()],
    )


def _heading(subject: str) -> str:
    """The subject with a capital, unless it is the name of a file."""
    return subject if {"/", "."} & set(subject) else f"{subject[:1].upper()}{subject[1:]}"
