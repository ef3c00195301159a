"""Agreement with other methods and accuracy against truth."""
