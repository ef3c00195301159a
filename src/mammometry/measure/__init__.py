"""Boundary, chest wall, volume and shape of breasts, from a surface."""
