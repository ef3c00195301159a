"""Results on disk: products, their records and file formats."""
