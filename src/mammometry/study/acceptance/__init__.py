"""Acceptance test of a device, after VDI/VDE 2634-3 and ISO 10360-13."""
