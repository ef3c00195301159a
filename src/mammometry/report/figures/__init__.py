"""Pictures, in one file per subject."""
