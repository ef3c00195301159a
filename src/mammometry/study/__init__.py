"""Agreement and accuracy of the instrument."""
