"""A virtual telephone: depth pictures of a body, and the scan that they are fused to."""
