"""Requests: who may send which, how many, and the server that takes them."""
