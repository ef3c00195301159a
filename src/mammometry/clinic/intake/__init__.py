"""Incoming photographs: resumable uploads and their checks."""
