"""Names within a backup's archive."""

FORMAT = 1
DATABASE = "database.jsonl"
"""The rows, one a line."""
MANIFEST = "manifest.json"
"""Format, version, time, migrations, and the SHA-256 of each file; the archive's last entry."""
