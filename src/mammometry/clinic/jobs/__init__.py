"""Jobs. A queue in the database, and a runner that gives its jobs to workers."""
