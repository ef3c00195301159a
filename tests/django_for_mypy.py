"""Django's settings as mypy's Django plugin reads them: a clinic's, whose folder need not exist."""

from pathlib import Path

from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.site import settings_of

globals().update(settings_of(ClinicConfig(folder=Path("/nowhere")), secret_key="only for types" * 5))
