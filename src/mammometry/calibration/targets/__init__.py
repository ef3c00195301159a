"""Calibration targets, one file per kind."""
