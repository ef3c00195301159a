"""Repeatability of volumes, from women who are captured repeatedly."""
