"""Photographic colour on the surface."""
