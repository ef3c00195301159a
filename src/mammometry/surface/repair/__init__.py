"""Elastic repair of the closed surface (paper 2.6.3)."""
