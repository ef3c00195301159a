"""Dense least-squares matching of a rectified pair (paper 2.3, Eq. 1)."""
