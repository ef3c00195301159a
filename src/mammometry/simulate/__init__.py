"""Captures with known truth."""
