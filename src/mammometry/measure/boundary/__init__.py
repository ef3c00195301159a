"""Where the breast ends."""
