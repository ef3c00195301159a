"""Volumes with their 95 % intervals."""
