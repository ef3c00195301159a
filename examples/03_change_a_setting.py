"""Change a setting: only the results that depend on it are computed again.

python examples/03_change_a_setting.py SESSION [SETTINGS.toml]
"""

import sys
from pathlib import Path

import mammometry as mm

session, *settings_files = sys.argv[1:]
settings = mm.Settings.load(Path(settings_files[0])) if settings_files else mm.Settings()
settings = settings.overridden(["surface.repair.rho=2.0"])

job = mm.open_session(session, settings)
job.surface()
print("made again:", ", ".join(job.store.made) or "nothing")
