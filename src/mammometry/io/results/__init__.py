"""Results on disk: products, their records, and how each is written."""
