"""Commands that measure our claims: accuracy against truth, and speed against other programs."""
