import os
import signal

import pytest

from designrl.checkpoint import load
from designrl.published import published, zoo_folder

# Nobody watches: without a window, SDL loads no OpenGL driver, whose LLVM (Mesa's) crashes the one
# of Triton, which comes with PyTorch's CUDA build.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

# A script's background process ignores Ctrl-C, and its children do; the tests of it need it.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def zoo_agent():
    """Loads the author's agent of an experiment, or skips where his weights are absent."""

    def get(experiment):
        if zoo_folder() is None:
            pytest.skip("the author's weights are not here; set DESIGNRL_ZOO to their folder")
        return load(published(zoo_folder(), experiment), experiment)

    return get
