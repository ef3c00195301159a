"""Jobs. One queue in the database for all work in the background, and a runner that does it."""
