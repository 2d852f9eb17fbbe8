"""The `designrl` command.

Outside the package, whose import takes a third of a second: Ctrl-C ends that quietly, too.
"""

import sys


def main() -> None:
    """Run the command."""
    try:
        from designrl import cli
    except KeyboardInterrupt:
        sys.exit(130)
    cli.main()
