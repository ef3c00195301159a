"""Back-ends for cameras: one file per kind, registered in `capture.camera`."""
