"""Calibrate the rig from photographs of a target (paper 2.2)."""
