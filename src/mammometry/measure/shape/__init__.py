"""Lengths, shape, ptosis, symmetry and body size."""
