"""Pages and their requests."""
