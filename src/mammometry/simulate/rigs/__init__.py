"""Virtual rigs, and poses of their calibration targets."""
