"""Disparities from photographs (paper 2.3)."""
