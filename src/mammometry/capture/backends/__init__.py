"""Back-ends that fire cameras: one file per kind, registered in `capture.camera`."""
