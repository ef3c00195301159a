"""Features measured in a picture of a target: corners, dots, lattices."""
