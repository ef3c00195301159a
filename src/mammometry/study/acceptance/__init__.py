"""Acceptance test of a measuring device with artefacts of known size, after VDI/VDE 2634-3 and ISO 10360-13."""
