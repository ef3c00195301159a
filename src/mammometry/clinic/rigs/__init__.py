"""Rigs: calibrations, drift, and whether a rig may be measured with today."""
