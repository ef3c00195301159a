"""Views of the clinic: its pages and their requests."""
