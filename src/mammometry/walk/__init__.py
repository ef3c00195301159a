"""Photographs by one telephone, taken on a walk around a patient who wears a printed board."""
