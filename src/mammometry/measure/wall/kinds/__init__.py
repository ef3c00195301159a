"""Walls, one in each file. `wall.registry` lists the files."""
