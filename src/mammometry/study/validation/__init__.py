"""Validation against a hospital's own reference: specimens in water or on a scale, segmentations."""
