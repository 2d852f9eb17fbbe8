"""A wheel in a clean environment, without a compiler: what works, and what it says that it lacks.

python tests/wheel.py                 of this Python
python tests/wheel.py python3.13      of another one, which builds it, with a compiler
"""

import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from test_parts import COMMANDS, IMPORTS, NAME, ROOT

import designrl

LEFT = (".git", ".venv", "build", "logs", "paper", "docs", "runs", ".*cache", "*.so", "*.egg-info")
STEPS = """
import gymnasium, designrl
for task in ("BipedalWalker", "BipedalWalkerHardcore", "Ant"):
    envs = gymnasium.make_vec(f"designrl/{task}-v0", 64, "vector_entry_point")
    envs.reset(seed=0)
    for _ in range(50):
        envs.step(envs.action_space.sample())
    print(task, envs.step(envs.action_space.sample())[1].mean())
"""


def main(python: str = sys.executable) -> None:
    """Build, install, use."""
    with tempfile.TemporaryDirectory(prefix="designrl-wheel-") as name:
        folder = Path(name)
        shutil.copytree(ROOT, folder / "source", ignore=shutil.ignore_patterns(*LEFT))
        build = [python, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", folder, "."]
        subprocess.run(build, cwd=folder / "source", check=True)
        (wheel,) = folder.glob("*.whl")
        print(f"{wheel.name}: {wheel.stat().st_size:,} bytes")
        shutil.rmtree(folder / "source")
        subprocess.run([python, "-m", "venv", folder / "env"], check=True)
        (folder / "work").mkdir()

        def run(*words, code: int = 0) -> subprocess.CompletedProcess:
            done = subprocess.run(
                [folder / "env/bin/python", *words],
                cwd=folder / "work",
                env={**os.environ, "PATH": str(folder / "env/bin")},  # no compiler, no swig
                capture_output=True,
                text=True,
            )
            assert done.returncode == code, (words, done.stderr)
            return done

        def install(extras: str = "") -> None:
            run("-m", "pip", "install", "--quiet", f"{wheel}{extras}")
            print(run("-m", "pip", "list", "--format=freeze").stdout.replace("\n", "  "))

        def evaluate(*words: str) -> None:
            ours = designrl.evaluate(NAME, episodes=3).scores.tolist()
            command = ["-m", "designrl", "evaluate", NAME, "--episodes", "3", "--json", *words]
            done = run(*command)
            assert json.loads(done.stdout)["scores"] == ours and not done.stderr, done.stderr
            print(f"{shlex.join(command)}: {ours}, as in the clone")

        install()
        print(run("-c", STEPS).stdout, end="")
        evaluate()
        print(run("-m", "designrl", "evaluate", "ant-morphology/seed0").stdout, end="")
        for command, extra in COMMANDS.items():
            said = run("-m", "designrl", *shlex.split(command), code=2).stderr
            assert said.count("\n") == 1 and f"designrl[{extra}]" in said, said
            print(f"{command}\n  {said}", end="")
        for words, extra in IMPORTS.items():
            said = run("-c", f"import designrl\n{words}", code=1).stderr.splitlines()[-1]
            assert f"designrl[{extra}]" in said, said
        install("[reference,view]")
        evaluate("--backend", "reference")
        print(run("-m", "designrl", "record", NAME, "-o", "a.mcap").stdout, end="")
        print(run("-m", "designrl", "replay", "a.mcap", "--save", "a.rrd").stdout, end="")


if __name__ == "__main__":
    main(*sys.argv[1:])
