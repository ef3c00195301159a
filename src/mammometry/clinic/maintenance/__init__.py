"""Maintenance of a clinic's data: backup, restore, export, erasure.

Backups and what is made of them, one patient's export, one patient's erasure.
"""
