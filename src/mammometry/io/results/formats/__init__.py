"""How each kind of product lies on disk."""
