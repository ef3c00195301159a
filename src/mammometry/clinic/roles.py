"""The four roles of a clinic's people."""

from django.db.models import TextChoices


class Role(TextChoices):
    """What somebody may do. One person may have several."""

    TECHNICIAN = "technician", "Technician"
    """Photographs: patients, visits, uploads, rigs, jobs."""
    CLINICIAN = "clinician", "Clinician"
    """Judges: results, drawing and confirming, comparing dates."""
    RESEARCHER = "researcher", "Researcher"
    """Pools: pseudonyms and figures, no names."""
    ADMINISTRATOR = "administrator", "Administrator"
    """Keeps: people, rigs, the audit. Sees no results."""


TECHNICIAN = frozenset({Role.TECHNICIAN})
CARE = frozenset({Role.TECHNICIAN, Role.CLINICIAN})
"""Who sees patients by name."""
CLINICIAN = frozenset({Role.CLINICIAN})
RIGS = frozenset({Role.TECHNICIAN, Role.ADMINISTRATOR})
STUDY = frozenset({Role.RESEARCHER, Role.CLINICIAN})
ADMINISTRATOR = frozenset({Role.ADMINISTRATOR})
EVERYBODY = frozenset(Role)
"""Everybody who is logged in."""
ANYONE: frozenset[Role] | None = None
"""Nobody need be logged in: pages that lead to the login."""
