"""Run the stages one by one and look at each stage's value.

Current results on disk are read, not computed again.

    python examples/02_stage_by_stage.py SESSION [SETTINGS.toml]
"""

import sys
from pathlib import Path

import numpy as np

import mammometry as mm
from mammometry.base.rounding import half_width, rounded_words

session, *settings_files = sys.argv[1:]
settings = mm.Settings.load(Path(settings_files[0])) if settings_files else mm.Settings()
job = mm.open_session(session, settings)

cameras = job.calibrate()
print(f"{len(cameras.rig.cameras)} cameras, {cameras.rms_px or float('nan'):.3f} px RMS; world: {cameras.world}")

for pair, found in job.match().items():
    print(f"{pair}: {found.valid.mean():.0%} of the rectified picture matched")
    print(f"  median expected error {np.median(found.sigma_px[found.valid]):.3f} px")

mesh = job.surface().repaired.mesh
print(f"surface: {len(mesh.vertices)} vertices, watertight: {mesh.is_watertight()}")

for name, measured in job.measure().items():
    half_cc = half_width(measured.interval_cc)
    print(f"{name}: {rounded_words(measured.volume_cc, half_cc, 'cc')}; {measured.wall_definition}")
