"""Photographs checked as they come, before anything is measured."""
