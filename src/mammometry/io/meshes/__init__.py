"""Meshes on disk: ours, and those of other devices."""
