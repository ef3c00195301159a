"""What was measured, and what people drew and confirmed."""

from __future__ import annotations

from django.conf import settings
from django.db import models

from mammometry.clinic.models.jobs import Job
from mammometry.clinic.models.keyed import Keyed
from mammometry.clinic.models.visits import Visit


class Measurement(Keyed):
    """Results of one visit, as one job made them."""

    visit = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="measurements")
    job = models.ForeignKey(Job, null=True, on_delete=models.SET_NULL, related_name="measurements")
    digest = models.CharField(max_length=64)
    made_at = models.DateTimeField()
    software = models.CharField(max_length=40)
    """Version of mammometry."""
    curves = models.JSONField(default=dict)
    """Breast → digest of the boundary that was measured (`measure.volume.attribution.curve_digest`)."""
    quantities = models.JSONField(default=list)
    """All measured numbers, with the names of `hospital.exported.Quantity`."""

    class Meta:
        ordering = ("-made_at",)

    def __str__(self) -> str:
        return f"{self.visit}, {self.digest[:12]}"


class Volume(Keyed):
    """One volume of a measurement, or why there is none."""

    class Side(models.TextChoices):
        """The patient's own sides."""

        LEFT = "left"
        RIGHT = "right"
        DIFFERENCE = "difference"
        MODEL = "model"

    measurement = models.ForeignKey(Measurement, on_delete=models.CASCADE, related_name="volumes")
    side = models.CharField(max_length=10, choices=Side.choices)
    definition = models.CharField(max_length=60)
    """What is called the breast."""
    volume_cc = models.FloatField(null=True)
    low_cc = models.FloatField(null=True)
    """Lower end of the 95 % interval, cc."""
    high_cc = models.FloatField(null=True)
    """Upper end of the 95 % interval, cc."""
    refused = models.CharField(max_length=1500, blank=True)
    """Why there is no volume; empty: there is one."""
    leads = models.BooleanField(default=False)
    """Its meaning leads the page among those of its side (`clinic.results.add_volumes`)."""

    class Meta:
        ordering = ("definition", "side")
        constraints = (models.UniqueConstraint(fields=("measurement", "side", "definition"), name="one_volume_each"),)
        indexes = (
            models.Index(
                fields=("measurement", "side", "definition", "volume_cc"),
                condition=models.Q(leads=True),
                name="leading_volumes",
            ),
        )

    def __str__(self) -> str:
        return f"{self.side}, {self.definition}"


class Drawing(Keyed):
    """Who drew or confirmed a boundary or landmark. The curve itself lies in the session folder."""

    class Action(models.TextChoices):
        """What somebody did."""

        DRAWN = "drawn"
        CONFIRMED = "confirmed"
        REMOVED = "removed"

    visit = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="drawings")
    item = models.CharField(max_length=60)
    """Name of the boundary or landmark."""
    action = models.CharField(max_length=10, choices=Action.choices)
    by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")
    at = models.DateTimeField(auto_now_add=True)
    digest = models.CharField(max_length=64, blank=True)
    """Of the file as it was then."""

    class Meta:
        ordering = ("-at",)

    def __str__(self) -> str:
        return f"{self.item} {self.action}"


class Confirmation(Keyed):
    """Somebody looked at one measured result and found it right. It changes no number."""

    measurement = models.ForeignKey(Measurement, on_delete=models.CASCADE, related_name="confirmations")
    curves = models.JSONField(default=dict)
    """Breast → digest of the boundary that was looked at."""
    at = models.DateTimeField(auto_now_add=True)
    by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-at",)

    def __str__(self) -> str:
        return f"{self.measurement} confirmed"


class Conclusion(Keyed):
    """What a clinician concluded of a visit, signed. A later one amends it and overwrites none."""

    visit = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="conclusions")
    measurement = models.ForeignKey(Measurement, null=True, on_delete=models.SET_NULL, related_name="conclusions")
    """The result that it is about."""
    text = models.TextField(max_length=4000)
    at = models.DateTimeField(auto_now_add=True)
    by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-at",)

    def __str__(self) -> str:
        return f"conclusion of {self.visit}"
