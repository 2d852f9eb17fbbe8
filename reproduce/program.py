"""How the commands of this package end."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from designrl.errors import InputError
from designrl.terminal import heed_signals, open_streams


@contextmanager
def program(name: str) -> Iterator[None]:
    """End the program with one sentence, not a traceback, on wrong input and on Ctrl-C."""
    open_streams()
    heed_signals()
    try:
        yield
    except (InputError, OSError) as error:
        sys.exit(f"{name}: {error}")
    except KeyboardInterrupt:
        sys.exit(f"{name}: stopped; the same command goes on")
