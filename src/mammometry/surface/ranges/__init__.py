"""Range images: distances from disparities, and the removal of dents (paper 2.4, 2.6.1, 2.6.2)."""
