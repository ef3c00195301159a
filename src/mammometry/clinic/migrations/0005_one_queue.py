import django.db.models.deletion
import django.utils.timezone
from django.db import migrations, models
from typing import Any


def queue_deliveries(apps: Any, _: object) -> None:
    """Turn each unfinished delivery into a job, with its number of attempts."""
    jobs = apps.get_model('clinic', 'Job').objects
    for delivery in apps.get_model('clinic', 'Delivery').objects.filter(state__in=('queued', 'sending')):
        jobs.create(
            kind='send', delivery=delivery, created_by=delivery.created_by, attempt=delivery.tries,
            message=delivery.message,
            due=delivery.next_try if delivery.state == 'queued' else django.utils.timezone.now(),
        )
        delivery.state, delivery.message = 'queued', ''
        delivery.save()


class Migration(migrations.Migration):

    dependencies = [
        ('clinic', '0004_once_and_notes'),
    ]

    operations = [
        migrations.AddField(
            model_name='job',
            name='delivery',
            field=models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='jobs', to='clinic.delivery'),
        ),
        migrations.AddField(
            model_name='job',
            name='due',
            field=models.DateTimeField(default=django.utils.timezone.now),
        ),
        migrations.AlterField(
            model_name='job',
            name='kind',
            field=models.CharField(choices=[('measure', 'Measure'), ('calibrate', 'Calibrate'), ('check', 'Check'), ('compare', 'Compare'), ('send', 'Send'), ('backup', 'Backup'), ('restore', 'Restore')], max_length=10),
        ),
        migrations.AddConstraint(
            model_name='job',
            constraint=models.UniqueConstraint(condition=models.Q(('state__in', ('queued', 'running'))), fields=('delivery',), name='one_open_job_a_delivery'),
        ),
        migrations.AddConstraint(
            model_name='job',
            constraint=models.UniqueConstraint(condition=models.Q(('kind__in', ('backup', 'restore')), ('state__in', ('queued', 'running'))), fields=('kind',), name='one_open_job_a_kind'),
        ),
        migrations.RunPython(queue_deliveries, migrations.RunPython.noop),
        migrations.RemoveField(
            model_name='delivery',
            name='next_try',
        ),
        migrations.RemoveField(
            model_name='delivery',
            name='tries',
        ),
        migrations.AlterField(
            model_name='delivery',
            name='state',
            field=models.CharField(choices=[('queued', 'Queued'), ('sent', 'Sent'), ('failed', 'Failed')], db_index=True, default='queued', max_length=8),
        ),
    ]
