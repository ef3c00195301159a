"""The kinds of target: a file here is a kind."""
