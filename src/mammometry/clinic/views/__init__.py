"""Pages and what pages ask for."""
