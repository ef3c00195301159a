"""The whole method as products: what is made of what, remembered between runs."""
