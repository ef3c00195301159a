"""Validation against a hospital's own truth: specimens in water or on a scale, segmentations."""
