"""Motion of cameras and body between calibration and photographs: found, corrected, said."""
