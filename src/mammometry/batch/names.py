"""Names that a batch and its workers share."""

MEMORY = "mammometry_mb"
"""Resource of a worker: memory that its tasks may take together, MB."""
CORES = "mammometry_cores"
"""Resource of a worker: cores that its tasks may take together."""
