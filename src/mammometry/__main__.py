"""``python -m mammometry`` is the command line."""

from mammometry.cli.main import main

main()
