"""Meshes on disk: our own, and those of other scanners."""
