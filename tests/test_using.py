"""Each block of docs/using.md is a script that runs, if the library that it is about is there."""

import ast
import subprocess
import sys
from importlib.util import find_spec

import pytest
from test_docs import ROOT, blocks
from test_house import imported

BLOCKS = blocks(ROOT / "docs/using.md", "python")


def libraries(block):
    return {name.partition(".")[0] for name in imported(ast.walk(ast.parse(block)))}


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: "-".join(sorted(libraries(block))))
def test_a_block_of_the_page_is_a_script_that_runs(block, tmp_path):
    for name in libraries(block):
        if not find_spec(name):
            pytest.skip(f"needs {name}")
    (tmp_path / "block.py").write_text(block)
    command = [sys.executable, "block.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
