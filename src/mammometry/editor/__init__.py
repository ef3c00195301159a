"""The local page on which boundaries and landmarks are drawn."""
