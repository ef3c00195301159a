"""Motion of cameras and body between calibration and photographs: detection and correction."""
