"""Cameras that were moved, exchanged or named wrongly."""
