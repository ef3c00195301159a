"""Photographs that come in. Resumable uploads, and what is checked while they come."""
