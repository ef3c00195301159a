"""Patients. Their names are here and nowhere else."""

from __future__ import annotations

import secrets

from django.db import models

from mammometry.clinic.models.keyed import Keyed

ALPHABET = "ACDEFGHJKLMNPQRTUVWXY34679"
"""Letters and digits that are not taken for one another: no B and 8, I and 1, O and 0, S and 5, Z and 2."""


def new_pseudonym() -> str:
    """P- and six random letters.

    26^6 = 309 million, drawn again where one is taken.
    """
    while True:
        drawn = "P-" + "".join(secrets.choice(ALPHABET) for _ in range(6))
        if not Patient.objects.filter(pseudonym=drawn).exists():
            return drawn


class Patient(Keyed):
    """Somebody who is photographed."""

    family_name = models.CharField(max_length=100)
    given_name = models.CharField(max_length=100)
    born = models.DateField(null=True, blank=True)
    record_number = models.CharField(max_length=64, unique=True)
    """As the hospital calls this patient."""
    pseudonym = models.CharField(max_length=8, unique=True, default=new_pseudonym, editable=False)
    """As everything outside this table calls this patient."""
    note = models.TextField(max_length=2000, blank=True)
    created = models.DateTimeField(auto_now_add=True)

    class Meta:
        ordering = ("family_name", "given_name", "record_number")

    def __str__(self) -> str:
        return self.pseudonym

    @property
    def name(self) -> str:
        """Family name, given name."""
        return f"{self.family_name}, {self.given_name}"
