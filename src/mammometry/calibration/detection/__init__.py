"""Find the target in all photographs."""
