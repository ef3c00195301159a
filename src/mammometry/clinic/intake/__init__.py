"""Photographs that come in: resumable uploads, and what is checked while they come."""
