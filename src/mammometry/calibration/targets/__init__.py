"""Calibration targets, a file a kind."""
