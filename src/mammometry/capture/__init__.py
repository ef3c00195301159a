"""The rig's cameras: set, fired, checked and written into a session."""
