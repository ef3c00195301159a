"""Two scans of one visit as one: registration, then fusion."""
