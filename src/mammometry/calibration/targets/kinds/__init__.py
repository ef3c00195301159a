"""Kinds of targets, one file per kind."""
