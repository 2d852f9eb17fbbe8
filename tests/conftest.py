import os
import signal
from pathlib import Path

import pytest

from designrl.checkpoint import load

ROOT = Path(__file__).resolve().parents[1]
ZOO = Path(os.environ.get("DESIGNRL_ZOO", ROOT / "../shared/zoo"))

# A script's background process ignores Ctrl-C, and its children do; the tests of it need it.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def zoo_agent():
    """Loads the author's agent of an experiment, or skips where his weights are absent."""
    from reproduce.scores import published

    def get(experiment):
        if not ZOO.is_dir():
            pytest.skip(f"the author's weights are not at {ZOO}; set DESIGNRL_ZOO to their folder")
        return load(published(ZOO, experiment), experiment)

    return get
