"""The subject's surface, from disparities (paper 2.4 to 2.6)."""
