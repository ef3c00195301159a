"""What fires cameras: a file a kind, entered in `capture.camera`."""
