"""Virtual subjects of known volume."""
