"""Finding and correcting records: search, near duplicates, corrections with undo, the bin."""
