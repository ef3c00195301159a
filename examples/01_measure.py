"""Measure a session: three lines, and their results.

python examples/01_measure.py SESSION [SETTINGS.toml]
"""

import sys
from pathlib import Path

import mammometry as mm

session, *settings_files = sys.argv[1:]
settings = mm.Settings.load(Path(settings_files[0])) if settings_files else mm.Settings()

results = mm.open_session(session, settings).run()

for name, words in results.words.items():
    print(f"{name}: {words}")
print(f"report: {results.report}")
