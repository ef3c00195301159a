"""Photographs with one telephone from all around a patient who wears a printed board."""
