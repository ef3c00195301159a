"""Virtual rigs, and where their targets are held."""
