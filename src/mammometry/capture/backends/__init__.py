"""Back-ends that fire cameras: a file a kind, entered in `capture.camera`."""
