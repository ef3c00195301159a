"""The tables of a clinic."""

import django.contrib.auth.models
import django.contrib.auth.validators
import django.db.models.deletion
import django.utils.timezone
import mammometry.clinic.models.patients
import mammometry.clinic.models.people
import uuid
from django.conf import settings
from django.db import migrations, models


class Migration(migrations.Migration):

    initial = True

    dependencies = [
        ('auth', '0012_alter_user_first_name_max_length'),
    ]

    operations = [
        migrations.CreateModel(
            name='Comparison',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('of', models.CharField(blank=True, max_length=200)),
                ('state', models.CharField(choices=[('queued', 'Queued'), ('done', 'Done'), ('refused', 'Refused')], default='queued', max_length=10)),
                ('table', models.JSONField(default=dict)),
                ('message', models.CharField(blank=True, max_length=1500)),
                ('made_at', models.DateTimeField(null=True)),
            ],
            options={
                'ordering': ('-made_at',),
            },
        ),
        migrations.CreateModel(
            name='Destination',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('name', models.CharField(max_length=100, unique=True)),
                ('kind', models.CharField(choices=[('dicom', 'DICOM (C-STORE)'), ('stow', 'DICOMweb (STOW-RS)'), ('worklist', 'Worklist (C-FIND)')], default='dicom', max_length=8)),
                ('address', models.CharField(max_length=200)),
                ('own_title', models.CharField(default='MAMMOMETRY', max_length=16)),
                ('encrypted', models.BooleanField(default=False)),
                ('authorities', models.CharField(blank=True, max_length=300)),
                ('certificate', models.CharField(blank=True, default='', max_length=300)),
                ('key', models.CharField(blank=True, default='', max_length=300)),
                ('commitment', models.BooleanField(default=False)),
                ('promise_port', models.PositiveIntegerField(blank=True, null=True)),
                ('active', models.BooleanField(default=True)),
            ],
            options={
                'ordering': ('name',),
            },
        ),
        migrations.CreateModel(
            name='Rig',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('name', models.CharField(max_length=100, unique=True)),
                ('note', models.TextField(blank=True, max_length=2000)),
                ('created', models.DateTimeField(auto_now_add=True)),
                ('definition', models.JSONField(default=dict)),
                ('active', models.BooleanField(default=True)),
            ],
            options={
                'ordering': ('name',),
            },
        ),
        migrations.CreateModel(
            name='Person',
            fields=[
                ('password', models.CharField(max_length=128, verbose_name='password')),
                ('last_login', models.DateTimeField(blank=True, null=True, verbose_name='last login')),
                ('is_superuser', models.BooleanField(default=False, help_text='Designates that this user has all permissions without explicitly assigning them.', verbose_name='superuser status')),
                ('username', models.CharField(error_messages={'unique': 'A user with that username already exists.'}, help_text='Required. 150 characters or fewer. Letters, digits and @/./+/-/_ only.', max_length=150, unique=True, validators=[django.contrib.auth.validators.UnicodeUsernameValidator()], verbose_name='username')),
                ('first_name', models.CharField(blank=True, max_length=150, verbose_name='first name')),
                ('last_name', models.CharField(blank=True, max_length=150, verbose_name='last name')),
                ('email', models.EmailField(blank=True, max_length=254, verbose_name='email address')),
                ('is_staff', models.BooleanField(default=False, help_text='Designates whether the user can log into this admin site.', verbose_name='staff status')),
                ('is_active', models.BooleanField(default=True, help_text='Designates whether this user should be treated as active. Unselect this instead of deleting accounts.', verbose_name='active')),
                ('date_joined', models.DateTimeField(default=django.utils.timezone.now, verbose_name='date joined')),
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('full_name', models.CharField(blank=True, max_length=200)),
                ('roles', models.JSONField(blank=True, default=list, validators=[mammometry.clinic.models.people.require_roles])),
                ('groups', models.ManyToManyField(blank=True, help_text='The groups this user belongs to. A user will get all permissions granted to each of their groups.', related_name='user_set', related_query_name='user', to='auth.group', verbose_name='groups')),
                ('user_permissions', models.ManyToManyField(blank=True, help_text='Specific permissions for this user.', related_name='user_set', related_query_name='user', to='auth.permission', verbose_name='user permissions')),
            ],
            options={
                'verbose_name_plural': 'people',
                'ordering': ('username',),
            },
            managers=[
                ('objects', django.contrib.auth.models.UserManager()),
            ],
        ),
        migrations.CreateModel(
            name='Calibration',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('taken_at', models.DateTimeField()),
                ('folder', models.CharField(max_length=200)),
                ('state', models.CharField(choices=[('uploading', 'Uploading'), ('queued', 'Queued'), ('running', 'Running'), ('done', 'Done'), ('failed', 'Failed')], default='uploading', max_length=12)),
                ('figures', models.JSONField(blank=True, default=dict)),
                ('verdict', models.CharField(blank=True, max_length=500)),
                ('current', models.BooleanField(default=False)),
                ('created_by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('rig', models.ForeignKey(on_delete=django.db.models.deletion.PROTECT, related_name='calibrations', to='clinic.rig')),
            ],
            options={
                'ordering': ('-taken_at',),
            },
        ),
        migrations.CreateModel(
            name='DailyCheck',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('taken_at', models.DateTimeField()),
                ('folder', models.CharField(blank=True, max_length=200)),
                ('figures', models.JSONField(blank=True, default=dict)),
                ('verdict', models.CharField(blank=True, max_length=500)),
                ('passed', models.BooleanField(null=True)),
                ('by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('calibration', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='checks', to='clinic.calibration')),
                ('rig', models.ForeignKey(on_delete=django.db.models.deletion.PROTECT, related_name='checks', to='clinic.rig')),
            ],
            options={
                'ordering': ('-taken_at',),
            },
        ),
        migrations.CreateModel(
            name='Job',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('kind', models.CharField(choices=[('measure', 'Measure'), ('calibrate', 'Calibrate'), ('check', 'Check'), ('compare', 'Compare')], max_length=10)),
                ('state', models.CharField(choices=[('queued', 'Queued'), ('running', 'Running'), ('done', 'Done'), ('failed', 'Failed'), ('cancelled', 'Cancelled')], db_index=True, default='queued', max_length=10)),
                ('attempt', models.PositiveIntegerField(default=0)),
                ('stage', models.CharField(blank=True, max_length=60)),
                ('fraction', models.FloatField(default=0.0)),
                ('message', models.CharField(blank=True, max_length=1500)),
                ('exit_code', models.IntegerField(null=True)),
                ('lease_owner', models.CharField(blank=True, max_length=100)),
                ('lease_until', models.DateTimeField(null=True)),
                ('digest', models.CharField(blank=True, max_length=64)),
                ('created', models.DateTimeField(auto_now_add=True)),
                ('started', models.DateTimeField(null=True)),
                ('ended', models.DateTimeField(null=True)),
                ('calibration', models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='jobs', to='clinic.calibration')),
                ('check_of_day', models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='jobs', to='clinic.dailycheck')),
                ('comparison', models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='jobs', to='clinic.comparison')),
                ('created_by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
            ],
            options={
                'ordering': ('created',),
            },
        ),
        migrations.CreateModel(
            name='Measurement',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('digest', models.CharField(max_length=64)),
                ('made_at', models.DateTimeField()),
                ('software', models.CharField(max_length=40)),
                ('curves', models.JSONField(default=dict)),
                ('quantities', models.JSONField(default=list)),
                ('job', models.ForeignKey(null=True, on_delete=django.db.models.deletion.SET_NULL, related_name='measurements', to='clinic.job')),
            ],
            options={
                'ordering': ('-made_at',),
            },
        ),
        migrations.CreateModel(
            name='Confirmation',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('curves', models.JSONField(default=dict)),
                ('at', models.DateTimeField(auto_now_add=True)),
                ('by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('measurement', models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='confirmations', to='clinic.measurement')),
            ],
            options={
                'ordering': ('-at',),
            },
        ),
        migrations.CreateModel(
            name='Patient',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('family_name', models.CharField(max_length=100)),
                ('given_name', models.CharField(max_length=100)),
                ('born', models.DateField(blank=True, null=True)),
                ('record_number', models.CharField(max_length=64, unique=True)),
                ('pseudonym', models.CharField(default=mammometry.clinic.models.patients.new_pseudonym, editable=False, max_length=8, unique=True)),
                ('note', models.TextField(blank=True, max_length=2000)),
                ('search_words', models.TextField(blank=True, default='', editable=False)),
                ('binned_at', models.DateTimeField(editable=False, null=True)),
                ('created', models.DateTimeField(auto_now_add=True)),
                ('merged_into', models.ForeignKey(editable=False, null=True, on_delete=django.db.models.deletion.CASCADE, related_name='merged', to='clinic.patient')),
            ],
            options={
                'ordering': ('family_name', 'given_name', 'record_number'),
            },
        ),
        migrations.CreateModel(
            name='Operation',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('kind', models.CharField(choices=[('mastectomy', 'Mastectomy'), ('conserving', 'Breast-conserving surgery'), ('expander', 'Tissue expander inserted'), ('filling', 'Tissue expander filled'), ('implant', 'Implant inserted'), ('flap', 'Reconstruction with a flap'), ('graft', 'Fat graft'), ('reduction', 'Reduction or lift'), ('augmentation', 'Augmentation'), ('other', 'Other')], max_length=12)),
                ('side', models.CharField(choices=[('left', 'Left'), ('right', 'Right'), ('both', 'Both')], max_length=5)),
                ('day', models.DateField()),
                ('volume_cc', models.FloatField(blank=True, null=True)),
                ('resected_g', models.FloatField(blank=True, null=True)),
                ('words', models.CharField(blank=True, max_length=300)),
                ('entered_at', models.DateTimeField(auto_now_add=True)),
                ('entered_by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('patient', models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='operations', to='clinic.patient')),
            ],
            options={
                'ordering': ('-day', 'kind'),
            },
        ),
        migrations.CreateModel(
            name='Consent',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('purpose', models.CharField(choices=[('pictures', 'Photographs and measurement'), ('research', 'Research, by pseudonym')], max_length=10)),
                ('given_on', models.DateField()),
                ('withdrawn_on', models.DateField(blank=True, null=True)),
                ('note', models.CharField(blank=True, max_length=300)),
                ('entered_at', models.DateTimeField(auto_now_add=True)),
                ('entered_by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('patient', models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='consents', to='clinic.patient')),
            ],
            options={
                'ordering': ('purpose', '-given_on'),
            },
        ),
        migrations.CreateModel(
            name='Visit',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('taken_at', models.DateTimeField()),
                ('subject_kind', models.CharField(choices=[('torso', 'Torso'), ('model', 'Model')], default='torso', max_length=8)),
                ('state', models.CharField(choices=[('new', 'New'), ('uploading', 'Uploading'), ('ready', 'Ready'), ('queued', 'Queued'), ('changed', 'Changed'), ('measured', 'Measured'), ('refused', 'Refused'), ('confirmed', 'Confirmed')], default='new', max_length=12)),
                ('occasion', models.CharField(blank=True, choices=[('before', 'Before the operation'), ('filling', 'Filling of an expander'), ('6 weeks', '6 weeks after'), ('3 months', '3 months after'), ('6 months', '6 months after'), ('1 year', '1 year after'), ('later', 'Later'), ('other', 'Other')], default='', max_length=10)),
                ('posture', models.CharField(blank=True, choices=[('leaning', 'Leaning forward'), ('standing', 'Standing'), ('lying', 'Lying')], default='', max_length=10)),
                ('note', models.TextField(blank=True, max_length=2000)),
                ('binned_at', models.DateTimeField(editable=False, null=True)),
                ('created', models.DateTimeField(auto_now_add=True)),
                ('calibration', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='visits', to='clinic.calibration')),
                ('created_by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('patient', models.ForeignKey(on_delete=django.db.models.deletion.PROTECT, related_name='visits', to='clinic.patient')),
                ('rig', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='visits', to='clinic.rig')),
            ],
            options={
                'ordering': ('-taken_at',),
            },
        ),
        migrations.CreateModel(
            name='Upload',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('camera', models.CharField(max_length=100)),
                ('name', models.CharField(blank=True, max_length=100)),
                ('size_bytes', models.BigIntegerField()),
                ('received_bytes', models.BigIntegerField(default=0)),
                ('sha256', models.CharField(blank=True, db_index=True, max_length=64)),
                ('state', models.CharField(choices=[('receiving', 'Receiving'), ('checked', 'Checked'), ('refused', 'Refused'), ('placed', 'Placed'), ('set aside', 'Set Aside')], default='receiving', max_length=12)),
                ('checks', models.JSONField(blank=True, default=list)),
                ('created', models.DateTimeField(auto_now_add=True)),
                ('calibration', models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='uploads', to='clinic.calibration')),
                ('check_of_day', models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='uploads', to='clinic.dailycheck')),
                ('created_by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('visit', models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='uploads', to='clinic.visit')),
            ],
            options={
                'ordering': ('created',),
            },
        ),
        migrations.CreateModel(
            name='Scan',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('scanner', models.CharField(max_length=100)),
                ('units', models.CharField(max_length=40)),
                ('textured', models.BooleanField(default=False)),
                ('sha256', models.CharField(max_length=64)),
                ('visit', models.OneToOneField(on_delete=django.db.models.deletion.CASCADE, related_name='scan', to='clinic.visit')),
            ],
            options={
                'abstract': False,
            },
        ),
        migrations.AddField(
            model_name='measurement',
            name='visit',
            field=models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='measurements', to='clinic.visit'),
        ),
        migrations.AddField(
            model_name='job',
            name='visit',
            field=models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='jobs', to='clinic.visit'),
        ),
        migrations.CreateModel(
            name='Drawing',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('item', models.CharField(max_length=60)),
                ('action', models.CharField(choices=[('drawn', 'Drawn'), ('confirmed', 'Confirmed'), ('removed', 'Removed')], max_length=10)),
                ('at', models.DateTimeField(auto_now_add=True)),
                ('digest', models.CharField(blank=True, max_length=64)),
                ('by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('visit', models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='drawings', to='clinic.visit')),
            ],
            options={
                'ordering': ('-at',),
            },
        ),
        migrations.CreateModel(
            name='Delivery',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('state', models.CharField(choices=[('queued', 'Queued'), ('sending', 'Sending'), ('sent', 'Sent'), ('failed', 'Failed')], db_index=True, default='queued', max_length=8)),
                ('tries', models.PositiveIntegerField(default=0)),
                ('next_try', models.DateTimeField()),
                ('message', models.CharField(blank=True, max_length=1500)),
                ('sent', models.PositiveIntegerField(default=0)),
                ('kept', models.BooleanField(null=True)),
                ('created', models.DateTimeField(auto_now_add=True)),
                ('ended', models.DateTimeField(null=True)),
                ('created_by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('destination', models.ForeignKey(on_delete=django.db.models.deletion.PROTECT, related_name='deliveries', to='clinic.destination')),
                ('visit', models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='deliveries', to='clinic.visit')),
            ],
            options={
                'ordering': ('-created',),
            },
        ),
        migrations.CreateModel(
            name='Correction',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('kind', models.CharField(choices=[('moved', 'Visit moved to another patient'), ('dated', 'Date of a visit corrected'), ('merged', 'Two records of one patient merged'), ('binned', 'Put into the bin')], max_length=8)),
                ('before', models.JSONField(default=dict)),
                ('after', models.JSONField(default=dict)),
                ('reason', models.CharField(max_length=500)),
                ('at', models.DateTimeField(auto_now_add=True)),
                ('undone_at', models.DateTimeField(null=True)),
                ('by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('undone_by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('patient', models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='corrections', to='clinic.patient')),
                ('visit', models.ForeignKey(null=True, on_delete=django.db.models.deletion.CASCADE, related_name='corrections', to='clinic.visit')),
            ],
            options={
                'ordering': ('-at',),
            },
        ),
        migrations.CreateModel(
            name='Conclusion',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('text', models.TextField(max_length=4000)),
                ('at', models.DateTimeField(auto_now_add=True)),
                ('by', models.ForeignKey(null=True, on_delete=django.db.models.deletion.PROTECT, related_name='+', to=settings.AUTH_USER_MODEL)),
                ('measurement', models.ForeignKey(null=True, on_delete=django.db.models.deletion.SET_NULL, related_name='conclusions', to='clinic.measurement')),
                ('visit', models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='conclusions', to='clinic.visit')),
            ],
            options={
                'ordering': ('-at',),
            },
        ),
        migrations.AddField(
            model_name='comparison',
            name='after',
            field=models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='comparisons', to='clinic.visit'),
        ),
        migrations.AddField(
            model_name='comparison',
            name='before',
            field=models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='comparisons_as_before', to='clinic.visit'),
        ),
        migrations.CreateModel(
            name='VisitOrder',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('accession', models.CharField(blank=True, max_length=64)),
                ('study_uid', models.CharField(blank=True, max_length=64)),
                ('referring', models.CharField(blank=True, max_length=200)),
                ('procedure_id', models.CharField(blank=True, max_length=64)),
                ('procedure', models.CharField(blank=True, max_length=200)),
                ('visit', models.OneToOneField(on_delete=django.db.models.deletion.CASCADE, related_name='order', to='clinic.visit')),
            ],
            options={
                'abstract': False,
            },
        ),
        migrations.CreateModel(
            name='Volume',
            fields=[
                ('id', models.UUIDField(default=uuid.uuid4, editable=False, primary_key=True, serialize=False)),
                ('side', models.CharField(choices=[('left', 'Left'), ('right', 'Right'), ('difference', 'Difference'), ('model', 'Model')], max_length=10)),
                ('definition', models.CharField(max_length=60)),
                ('volume_cc', models.FloatField(null=True)),
                ('low_cc', models.FloatField(null=True)),
                ('high_cc', models.FloatField(null=True)),
                ('refused', models.CharField(blank=True, max_length=1500)),
                ('leads', models.BooleanField(default=False)),
                ('measurement', models.ForeignKey(on_delete=django.db.models.deletion.CASCADE, related_name='volumes', to='clinic.measurement')),
            ],
            options={
                'ordering': ('definition', 'side'),
            },
        ),
        migrations.AddConstraint(
            model_name='calibration',
            constraint=models.UniqueConstraint(condition=models.Q(('current', True)), fields=('rig',), name='one_current_calibration'),
        ),
        migrations.AddConstraint(
            model_name='job',
            constraint=models.UniqueConstraint(condition=models.Q(('state__in', ('queued', 'running'))), fields=('visit',), name='one_open_job_a_visit'),
        ),
        migrations.AddConstraint(
            model_name='job',
            constraint=models.UniqueConstraint(condition=models.Q(('state__in', ('queued', 'running'))), fields=('calibration',), name='one_open_job_a_calibration'),
        ),
        migrations.AddConstraint(
            model_name='job',
            constraint=models.UniqueConstraint(condition=models.Q(('state__in', ('queued', 'running'))), fields=('check_of_day',), name='one_open_job_a_check_of_day'),
        ),
        migrations.AddConstraint(
            model_name='job',
            constraint=models.UniqueConstraint(condition=models.Q(('state__in', ('queued', 'running'))), fields=('comparison',), name='one_open_job_a_comparison'),
        ),
        migrations.AddConstraint(
            model_name='comparison',
            constraint=models.UniqueConstraint(fields=('before', 'after'), name='one_comparison_each'),
        ),
        migrations.AddIndex(
            model_name='volume',
            index=models.Index(condition=models.Q(('leads', True)), fields=['measurement', 'side', 'definition', 'volume_cc'], name='leading_volumes'),
        ),
        migrations.AddConstraint(
            model_name='volume',
            constraint=models.UniqueConstraint(fields=('measurement', 'side', 'definition'), name='one_volume_each'),
        ),
    ]
