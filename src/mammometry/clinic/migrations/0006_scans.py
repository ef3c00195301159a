"""Visits whose mesh another device made: they have no rig."""

import uuid

import django.db.models.deletion
from django.db import migrations, models


class Migration(migrations.Migration):
    """Lets a visit have no rig."""

    dependencies = [("clinic", "0005_promises")]
    operations = [
        migrations.AlterField(
            "visit",
            "rig",
            models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.PROTECT, related_name="visits", to="clinic.rig"
            ),
        ),
        migrations.CreateModel(
            "Scan",
            fields=[
                ("id", models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ("scanner", models.CharField(max_length=100)),
                ("units", models.CharField(max_length=40)),
                ("textured", models.BooleanField(default=False)),
                ("sha256", models.CharField(max_length=64)),
                (
                    "visit",
                    models.OneToOneField(
                        on_delete=django.db.models.deletion.CASCADE, related_name="scan", to="clinic.visit"
                    ),
                ),
            ],
            options={"abstract": False},
        ),
    ]
