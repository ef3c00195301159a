"""Requests: access, limits, and the server."""
