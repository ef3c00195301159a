"""Repeatability of volumes when women are captured again: components of variance, detectable change, plan."""
