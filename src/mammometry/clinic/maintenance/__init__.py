"""Maintenance of a clinic's data: backup, restore, export, erasure."""
