"""Pictures, a file a subject."""
