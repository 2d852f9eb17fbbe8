import os
import signal

import pytest

from designrl import author
from designrl.names import load

# Nobody watches: without a window, SDL loads no OpenGL driver, whose LLVM (Mesa's) crashes the one
# of Triton, which comes with PyTorch's CUDA build.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

# A script's background process ignores Ctrl-C, and its children do; the tests of it need it.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_terminal_summary(terminalreporter):
    if author.zoo() is None:
        terminalreporter.write_line("Tests with the author's weights were skipped: no AUTHOR_ZOO.")


@pytest.fixture
def author_agent():
    """Loads the author's agent of an experiment, or skips where his weights are absent."""

    def get(experiment):
        if author.zoo() is None:
            pytest.skip("the author's weights are not here; set AUTHOR_ZOO to their folder")
        return load(author.file_of(author.zoo(), experiment), experiment)

    return get
