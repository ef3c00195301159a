"""Cameras in files: our own, and those of other programs."""
