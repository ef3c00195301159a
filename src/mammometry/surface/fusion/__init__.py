"""Range images fused into one closed surface (paper 2.5)."""
