"""The command line: parse, load, call, save, map errors to exit codes."""
