"""Volume and its 95 % interval."""
