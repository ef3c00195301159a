"""The trunk without breasts: body frame, axis, radius, flattened skin."""
