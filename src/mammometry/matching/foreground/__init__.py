"""The subject in each photograph."""
