"""What keeps a clinic's data.

Backups and what is made of them, one patient's export, one patient's erasure.
"""
