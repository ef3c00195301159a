"""Command line: parse, load, call, save, turn errors into exit codes."""
