"""Features measured in images of a target: corners, dots, lattices."""
