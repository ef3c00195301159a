"""Range images: distances from disparities, their patches and their dents (paper 2.4, 2.6.1, 2.6.2)."""
