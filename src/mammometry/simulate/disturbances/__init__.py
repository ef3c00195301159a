"""Disturbances of a virtual capture: patients, surroundings, cameras."""
