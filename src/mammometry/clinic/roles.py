"""The four roles of a clinic's people."""

from django.db.models import TextChoices


class Role(TextChoices):
    """Roles of people. One person may have several."""

    TECHNICIAN = "technician", "Technician"
    """Takes photographs: patients, visits, uploads, rigs, jobs."""
    CLINICIAN = "clinician", "Clinician"
    """Evaluates: results, drawing and confirming, comparing dates."""
    RESEARCHER = "researcher", "Researcher"
    """Does studies: pseudonyms and figures, no names."""
    ADMINISTRATOR = "administrator", "Administrator"
    """Manages: people, rigs, the audit. Sees no results."""


TECHNICIAN = frozenset({Role.TECHNICIAN})
CARE = frozenset({Role.TECHNICIAN, Role.CLINICIAN})
"""Roles that see patients' names."""
CLINICIAN = frozenset({Role.CLINICIAN})
RIGS = frozenset({Role.TECHNICIAN, Role.ADMINISTRATOR})
STUDY = frozenset({Role.RESEARCHER, Role.CLINICIAN})
ADMINISTRATOR = frozenset({Role.ADMINISTRATOR})
EVERYBODY = frozenset(Role)
"""Everybody who can log in."""
ANYONE: frozenset[Role] | None = None
"""Also people who are not logged in."""
