"""How flat targets are found in photographs."""
