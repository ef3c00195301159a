"""Results as text, numbers and tables."""
