"""Cameras in files: our own, OpenCV's, COLMAP's, Kalibr's."""
