"""Everything one can do from Python."""
