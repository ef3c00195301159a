"""From a scene to photographs."""
