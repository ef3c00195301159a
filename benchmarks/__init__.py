"""Commands that measure what we claim: accuracy against truth, and speed against peers in the same run."""
