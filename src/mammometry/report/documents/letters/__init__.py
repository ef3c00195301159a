"""Letters of all scripts on paper: order, shapes and fonts."""
