"""Boundary, chest wall, volume, shape."""
