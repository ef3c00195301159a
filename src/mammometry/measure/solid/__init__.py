"""Cutting, sewing and filling closed meshes."""
