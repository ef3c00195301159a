"""How long things take, each by one command."""
