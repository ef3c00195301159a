"""Canvas, shading and thinning that all pictures are drawn with."""
