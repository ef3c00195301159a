"""Our own certificates, and archives' promises to keep what was sent."""

from django.db import migrations, models


class Migration(migrations.Migration):
    """Adds columns.

    Archives that are entered already are asked for nothing new.
    """

    dependencies = [("clinic", "0004_one_open_job")]
    operations = [
        migrations.AddField("destination", "certificate", models.CharField(blank=True, max_length=300, default="")),
        migrations.AddField("destination", "key", models.CharField(blank=True, max_length=300, default="")),
        migrations.AddField("destination", "commitment", models.BooleanField(default=False)),
        migrations.AddField("destination", "promise_port", models.PositiveIntegerField(blank=True, null=True)),
        migrations.AddField("delivery", "kept", models.BooleanField(null=True)),
    ]
