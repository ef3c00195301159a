"""Semi-global matching, from which the dense matching starts."""
