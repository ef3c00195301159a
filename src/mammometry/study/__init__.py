"""Studies: agreement with other methods, repeatability, and accuracy against a truth."""
