"""How near the truth: one command a page of docs/measured.md."""
