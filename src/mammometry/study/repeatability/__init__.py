"""Repeatability of volumes of women who are captured again."""
