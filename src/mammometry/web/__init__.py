"""Servers of pages: limits, replies, and the login of the person at this computer."""
