"""Readers for mesh files of other programs."""
