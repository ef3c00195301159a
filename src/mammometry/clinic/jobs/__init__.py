"""Jobs: one queue in the database for all background work, and a runner that does it."""
