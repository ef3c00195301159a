"""Find and correct records: search, possible duplicates, corrections with undo, the bin."""
