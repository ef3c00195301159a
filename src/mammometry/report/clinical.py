"""What a clinic knows of a visit and its photographs do not tell."""

from __future__ import annotations

import datetime
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Signed:
    """Something that somebody said, with name and time."""

    by: str
    at: datetime.datetime
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clinical:
    """Who was photographed, what was done before, and what a clinician says of it.

    A report is rendered with it and never stored with it: names stand in the clinic's database alone.
    """

    patient: str = ""
    """Family name, given name."""
    born: datetime.date | None = None
    record: str = ""
    """Number of the patient's record."""
    taken: datetime.datetime | None = None
    """When the photographs or the scan were taken, local time."""
    occasion: str = ""
    """Why the patient came: "6 weeks after"."""
    posture: str = ""
    """ "leaning forward", "standing", "lying"; empty: nobody said."""
    operations: tuple[str, ...] = ()
    """One sentence each, the newest first: "Implant inserted, left, 2026-03-02, 300 cc"."""
    change: tuple[str, ...] = ()
    """The verdict against the visit before, a sentence a breast. Empty: there is none."""
    confirmed: Signed | None = None
    """Who looked at the measured boundaries and found them right. None: nobody yet."""
    conclusions: tuple[Signed, ...] = ()
    """The newest first; the others were amended by it."""
