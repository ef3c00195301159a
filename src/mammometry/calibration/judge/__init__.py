"""Assess whether a calibration is good, and whether it is still valid."""
