"""Rendering of scenes as photographs."""
