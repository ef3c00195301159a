"""The rig's cameras: settings, capture, checks, and storage in a session."""
