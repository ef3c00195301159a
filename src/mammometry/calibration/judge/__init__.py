"""Is the calibration good, and does it still hold?"""
