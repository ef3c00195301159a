"""Pages of a patient and a visit."""
