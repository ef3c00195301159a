"""Landmarks and paths on the skin."""
