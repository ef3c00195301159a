"""What the renderer shows."""
