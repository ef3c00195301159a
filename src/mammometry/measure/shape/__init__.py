"""Lengths, shape, symmetry."""
