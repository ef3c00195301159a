"""Virtual captures with known truth."""
