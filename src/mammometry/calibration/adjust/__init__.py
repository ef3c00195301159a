"""Adjust the whole rig: from detections to cameras with their covariance."""
