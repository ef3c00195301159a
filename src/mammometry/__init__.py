"""Breast volume, shape and symmetry from calibrated multi-view stereo photographs."""

__version__ = "0.1.0"
