"""`python -m designrl` is the `designrl` command."""

from designrl.cli import main

main()
