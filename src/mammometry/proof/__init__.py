"""Whole sessions against their truth: one session stage by stage, nine plaster models from photographs to volume."""
