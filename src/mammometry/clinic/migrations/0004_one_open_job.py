"""At most one open job a visit, calibration or daily check."""

from django.apps.registry import Apps
from django.db import migrations, models
from django.db.backends.base.schema import BaseDatabaseSchemaEditor
from django.utils import timezone

_OPEN = ("queued", "running")
_ABOUT = ("visit", "calibration", "check_of_day")


def _cancel_doubles(apps: Apps, schema_editor: BaseDatabaseSchemaEditor) -> None:
    """Cancel all open jobs about one thing but one.

    That at work, else the oldest.
    """
    jobs = apps.get_model("clinic", "Job").objects
    seen: set[tuple[str, object]] = set()
    for job in jobs.filter(state__in=_OPEN).order_by("-state", "created", "pk"):  # running before queued
        about = next((name, key) for name in _ABOUT if (key := getattr(job, f"{name}_id")) is not None)
        if about in seen:
            jobs.filter(pk=job.pk).update(state="cancelled", ended=timezone.now())
        seen.add(about)


class Migration(migrations.Migration):
    """Cancels what is open twice, then lets the database refuse it."""

    dependencies = [("clinic", "0003_deliveries")]
    operations = [
        migrations.RunPython(_cancel_doubles, migrations.RunPython.noop),
        *(
            migrations.AddConstraint(
                model_name="job",
                constraint=models.UniqueConstraint(
                    condition=models.Q(("state__in", _OPEN)), fields=(field,), name=f"one_open_job_a_{field}"
                ),
            )
            for field in _ABOUT
        ),
    ]
