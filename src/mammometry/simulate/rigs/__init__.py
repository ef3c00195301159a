"""Virtual rigs, and poses of their targets."""
