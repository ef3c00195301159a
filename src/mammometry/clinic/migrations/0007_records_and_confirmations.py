"""Consent, operations, confirmations, conclusions, comparisons and corrections."""

import uuid
from typing import Any

import django.db.models.deletion
from django.conf import settings
from django.db import migrations, models

from mammometry.clinic.search_words import words_of

LEADING = ("measured wall", "flat chest", "named wall", "muscle", "closed solid", "any")


def fill_search_words(apps: Any, schema_editor: Any) -> None:
    """Let patients who were entered before be found by a search."""
    for patient in apps.get_model("clinic", "Patient").objects.iterator():
        texts = patient.family_name, patient.given_name, patient.record_number, patient.pseudonym
        patient.search_words = words_of(texts)
        patient.save(update_fields=["search_words"])


def mark_leading_volumes(apps: Any, schema_editor: Any) -> None:
    """Mark which volume of each side leads, of measurements that were entered before."""
    volumes = apps.get_model("clinic", "Volume").objects
    leaders: dict[tuple[Any, str], tuple[tuple[int, str], Any]] = {}
    columns = "measurement_id", "side", "definition", "pk"
    for measurement, side, definition, key in volumes.order_by().values_list(*columns).iterator():
        rank = LEADING.index(definition) if definition in LEADING else len(LEADING)
        candidate = (rank, definition), key
        leaders[measurement, side] = min(leaders.get((measurement, side), candidate), candidate)
    keys = [key for _, key in leaders.values()]
    for first in range(0, len(keys), 500):
        volumes.filter(pk__in=keys[first : first + 500]).update(leads=True)


class Migration(migrations.Migration):
    dependencies = [
        ("clinic", "0006_scans"),
    ]

    operations = [
        migrations.CreateModel(
            name="Conclusion",
            fields=[
                ("id", models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ("text", models.TextField(max_length=4000)),
                ("at", models.DateTimeField(auto_now_add=True)),
            ],
            options={
                "ordering": ("-at",),
            },
        ),
        migrations.CreateModel(
            name="Confirmation",
            fields=[
                ("id", models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ("curves", models.JSONField(default=dict)),
                ("at", models.DateTimeField(auto_now_add=True)),
            ],
            options={
                "ordering": ("-at",),
            },
        ),
        migrations.CreateModel(
            name="Consent",
            fields=[
                ("id", models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                (
                    "purpose",
                    models.CharField(
                        choices=[("pictures", "Photographs and measurement"), ("research", "Research, by pseudonym")],
                        max_length=10,
                    ),
                ),
                ("given_on", models.DateField()),
                ("withdrawn_on", models.DateField(blank=True, null=True)),
                ("note", models.CharField(blank=True, max_length=300)),
                ("entered_at", models.DateTimeField(auto_now_add=True)),
            ],
            options={
                "ordering": ("purpose", "-given_on"),
            },
        ),
        migrations.CreateModel(
            name="Correction",
            fields=[
                ("id", models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                (
                    "kind",
                    models.CharField(
                        choices=[
                            ("moved", "Visit moved to another patient"),
                            ("dated", "Date of a visit corrected"),
                            ("merged", "Two records of one patient merged"),
                            ("binned", "Put into the bin"),
                        ],
                        max_length=8,
                    ),
                ),
                ("before", models.JSONField(default=dict)),
                ("after", models.JSONField(default=dict)),
                ("reason", models.CharField(max_length=500)),
                ("at", models.DateTimeField(auto_now_add=True)),
                ("undone_at", models.DateTimeField(null=True)),
            ],
            options={
                "ordering": ("-at",),
            },
        ),
        migrations.CreateModel(
            name="Operation",
            fields=[
                ("id", models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                (
                    "kind",
                    models.CharField(
                        choices=[
                            ("mastectomy", "Mastectomy"),
                            ("conserving", "Breast-conserving surgery"),
                            ("expander", "Tissue expander inserted"),
                            ("filling", "Tissue expander filled"),
                            ("implant", "Implant inserted"),
                            ("flap", "Reconstruction with a flap"),
                            ("graft", "Fat graft"),
                            ("reduction", "Reduction or lift"),
                            ("augmentation", "Augmentation"),
                            ("other", "Other"),
                        ],
                        max_length=12,
                    ),
                ),
                (
                    "side",
                    models.CharField(choices=[("left", "Left"), ("right", "Right"), ("both", "Both")], max_length=5),
                ),
                ("day", models.DateField()),
                ("volume_cc", models.FloatField(blank=True, null=True)),
                ("resected_g", models.FloatField(blank=True, null=True)),
                ("words", models.CharField(blank=True, max_length=300)),
                ("entered_at", models.DateTimeField(auto_now_add=True)),
            ],
            options={
                "ordering": ("-day", "kind"),
            },
        ),
        migrations.AddField(
            model_name="measurement",
            name="curves",
            field=models.JSONField(default=dict),
        ),
        migrations.AddField(
            model_name="measurement",
            name="quantities",
            field=models.JSONField(default=list),
        ),
        migrations.AddField(
            model_name="patient",
            name="binned_at",
            field=models.DateTimeField(editable=False, null=True),
        ),
        migrations.AddField(
            model_name="patient",
            name="merged_into",
            field=models.ForeignKey(
                editable=False,
                null=True,
                on_delete=django.db.models.deletion.CASCADE,
                related_name="merged",
                to="clinic.patient",
            ),
        ),
        migrations.AddField(
            model_name="patient",
            name="search_words",
            field=models.TextField(blank=True, default="", editable=False),
        ),
        migrations.RunPython(fill_search_words, migrations.RunPython.noop),
        migrations.AddField(
            model_name="volume",
            name="leads",
            field=models.BooleanField(default=False),
        ),
        migrations.RunPython(mark_leading_volumes, migrations.RunPython.noop),
        migrations.AddField(
            model_name="visit",
            name="binned_at",
            field=models.DateTimeField(editable=False, null=True),
        ),
        migrations.AddField(
            model_name="visit",
            name="occasion",
            field=models.CharField(
                blank=True,
                choices=[
                    ("before", "Before the operation"),
                    ("filling", "Filling of an expander"),
                    ("6 weeks", "6 weeks after"),
                    ("3 months", "3 months after"),
                    ("6 months", "6 months after"),
                    ("1 year", "1 year after"),
                    ("later", "Later"),
                    ("other", "Other"),
                ],
                default="",
                max_length=10,
            ),
        ),
        migrations.AddField(
            model_name="visit",
            name="posture",
            field=models.CharField(
                blank=True,
                choices=[("leaning", "Leaning forward"), ("standing", "Standing"), ("lying", "Lying")],
                default="",
                max_length=10,
            ),
        ),
        migrations.AlterField(
            model_name="job",
            name="kind",
            field=models.CharField(
                choices=[
                    ("measure", "Measure"),
                    ("calibrate", "Calibrate"),
                    ("check", "Check"),
                    ("compare", "Compare"),
                ],
                max_length=10,
            ),
        ),
        migrations.AlterField(
            model_name="upload",
            name="sha256",
            field=models.CharField(blank=True, db_index=True, max_length=64),
        ),
        migrations.AlterField(
            model_name="upload",
            name="state",
            field=models.CharField(
                choices=[
                    ("receiving", "Receiving"),
                    ("checked", "Checked"),
                    ("refused", "Refused"),
                    ("placed", "Placed"),
                    ("set aside", "Set Aside"),
                ],
                default="receiving",
                max_length=12,
            ),
        ),
        migrations.AlterField(
            model_name="visit",
            name="state",
            field=models.CharField(
                choices=[
                    ("new", "New"),
                    ("uploading", "Uploading"),
                    ("ready", "Ready"),
                    ("queued", "Queued"),
                    ("changed", "Changed"),
                    ("measured", "Measured"),
                    ("refused", "Refused"),
                    ("confirmed", "Confirmed"),
                ],
                default="new",
                max_length=12,
            ),
        ),
        migrations.CreateModel(
            name="Comparison",
            fields=[
                ("id", models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ("of", models.CharField(blank=True, max_length=200)),
                (
                    "state",
                    models.CharField(
                        choices=[("queued", "Queued"), ("done", "Done"), ("refused", "Refused")],
                        default="queued",
                        max_length=10,
                    ),
                ),
                ("table", models.JSONField(default=dict)),
                ("message", models.CharField(blank=True, max_length=1500)),
                ("made_at", models.DateTimeField(null=True)),
                (
                    "after",
                    models.ForeignKey(
                        on_delete=django.db.models.deletion.CASCADE, related_name="comparisons", to="clinic.visit"
                    ),
                ),
                (
                    "before",
                    models.ForeignKey(
                        on_delete=django.db.models.deletion.CASCADE,
                        related_name="comparisons_as_before",
                        to="clinic.visit",
                    ),
                ),
            ],
            options={
                "ordering": ("-made_at",),
            },
        ),
        migrations.AddField(
            model_name="job",
            name="comparison",
            field=models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.CASCADE, related_name="jobs", to="clinic.comparison"
            ),
        ),
        migrations.AddConstraint(
            model_name="job",
            constraint=models.UniqueConstraint(
                condition=models.Q(("state__in", ("queued", "running"))),
                fields=("comparison",),
                name="one_open_job_a_comparison",
            ),
        ),
        migrations.AddField(
            model_name="conclusion",
            name="by",
            field=models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.PROTECT, related_name="+", to=settings.AUTH_USER_MODEL
            ),
        ),
        migrations.AddField(
            model_name="conclusion",
            name="measurement",
            field=models.ForeignKey(
                null=True,
                on_delete=django.db.models.deletion.SET_NULL,
                related_name="conclusions",
                to="clinic.measurement",
            ),
        ),
        migrations.AddField(
            model_name="conclusion",
            name="visit",
            field=models.ForeignKey(
                on_delete=django.db.models.deletion.CASCADE, related_name="conclusions", to="clinic.visit"
            ),
        ),
        migrations.AddField(
            model_name="confirmation",
            name="by",
            field=models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.PROTECT, related_name="+", to=settings.AUTH_USER_MODEL
            ),
        ),
        migrations.AddField(
            model_name="confirmation",
            name="measurement",
            field=models.ForeignKey(
                on_delete=django.db.models.deletion.CASCADE, related_name="confirmations", to="clinic.measurement"
            ),
        ),
        migrations.AddField(
            model_name="consent",
            name="entered_by",
            field=models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.PROTECT, related_name="+", to=settings.AUTH_USER_MODEL
            ),
        ),
        migrations.AddField(
            model_name="consent",
            name="patient",
            field=models.ForeignKey(
                on_delete=django.db.models.deletion.CASCADE, related_name="consents", to="clinic.patient"
            ),
        ),
        migrations.AddField(
            model_name="correction",
            name="by",
            field=models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.PROTECT, related_name="+", to=settings.AUTH_USER_MODEL
            ),
        ),
        migrations.AddField(
            model_name="correction",
            name="patient",
            field=models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.CASCADE, related_name="corrections", to="clinic.patient"
            ),
        ),
        migrations.AddField(
            model_name="correction",
            name="undone_by",
            field=models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.PROTECT, related_name="+", to=settings.AUTH_USER_MODEL
            ),
        ),
        migrations.AddField(
            model_name="correction",
            name="visit",
            field=models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.CASCADE, related_name="corrections", to="clinic.visit"
            ),
        ),
        migrations.AddField(
            model_name="operation",
            name="entered_by",
            field=models.ForeignKey(
                null=True, on_delete=django.db.models.deletion.PROTECT, related_name="+", to=settings.AUTH_USER_MODEL
            ),
        ),
        migrations.AddField(
            model_name="operation",
            name="patient",
            field=models.ForeignKey(
                on_delete=django.db.models.deletion.CASCADE, related_name="operations", to="clinic.patient"
            ),
        ),
        migrations.AddConstraint(
            model_name="comparison",
            constraint=models.UniqueConstraint(fields=("before", "after"), name="one_comparison_each"),
        ),
        migrations.AddIndex(
            model_name="volume",
            index=models.Index(
                condition=models.Q(("leads", True)),
                fields=["measurement", "side", "definition", "volume_cc"],
                name="leading_volumes",
            ),
        ),
    ]
