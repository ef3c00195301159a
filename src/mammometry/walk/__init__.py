"""Walks: photographs taken with one telephone around a patient who wears a printed board."""
