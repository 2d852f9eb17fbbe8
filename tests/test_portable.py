"""The portable engine on other machines: 64-bit ARM and WebAssembly give x86-64's bits.

python tests/test_portable.py 50     all of the experiments, 50 agents of each, whole episodes
"""

import platform
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from designrl import engine
from designrl.envs.tasks import engine_task
from designrl.experiments import EXPERIMENTS, get_experiment
from designrl.names import PRETRAINED, load
from designrl.policy import noise_stds

ROOT = Path(__file__).parents[1]
NATIVE = ROOT / "designrl" / "engine" / "native"
SOURCES = [*NATIVE.glob("*/*.cpp"), ROOT / "tests" / "native" / "episodes.cpp"]
# Those of setup.py that the bits hang on, and what a machine without a C++ library needs.
FLAGS = ["-std=c++17", "-O2", "-g0", "-ffp-contract=off", "-fno-math-errno"]
FLAGS += ["-fno-trapping-math", "-fno-exceptions", "-fno-rtti", "-fno-threadsafe-statics"]
FLAGS += [f"-I{NATIVE}"]
ARM = ["aarch64-linux-gnu-g++", "-static"]
WASM = [sys.executable, "-m", "ziglang", "c++", "-target", "wasm32-wasi"]
WASM += ["-msimd128", "-nostdlib++", "-s"]
# A program for WASI, run by Node: files as its standard input and output.
RUN_WASM = """
const { WASI } = require("wasi"), fs = require("fs");
const [program, task, input, output] = process.argv.slice(1);
const stdin = fs.openSync(input, "r"), stdout = fs.openSync(output, "w");
const wasi = new WASI({ version: "preview1", args: [program, task], stdin, stdout });
const module = new WebAssembly.Module(fs.readFileSync(program));
wasi.start(new WebAssembly.Instance(module, { wasi_snapshot_preview1: wasi.wasiImport }));
"""

pytestmark = pytest.mark.skipif(
    platform.machine() != "x86_64" or engine.missing_reason() is not None,
    reason="compares with the engine on x86-64",
)


def batch_of(name, candidates, rollouts):
    """Arguments of `rollout` but the task: in turn a random agent and a published one."""
    experiment, rng = get_experiment(name), np.random.default_rng(0)
    network = experiment.network
    trained = [load(path, name) for path in sorted((PRETRAINED / name).glob("*.safetensors"))]
    trained = [agent.parameters for agent in trained if agent.network == network]
    parameters = 0.3 * rng.standard_normal((candidates, experiment.num_parameters))
    parameters[1::2] = [trained[i % len(trained)] for i in range(candidates // 2)]
    own, design = np.split(parameters, [network.num_parameters], axis=1)
    weights, log_stds = np.split(own, [network.num_weights], axis=1)
    scales = np.ones((candidates, experiment.body.design.size))
    if experiment.design:
        scales = experiment.design.scales(design)
    return {
        "sizes": network.sizes,
        "weights": weights,
        "designs": scales,
        "reward_factors": np.ones(candidates),
        "seeds": rng.integers(2**40, size=(candidates, rollouts)),
        "output_tanh": network.output == "tanh",
        "time_scale": network.time_scale,
        "noise_stds": noise_stds(log_stds) if network.noise else None,
    }


def write(path, task, batch):
    """A batch as tests/native/episodes.cpp reads it."""
    sizes, weights, noise = (batch[key] for key in ("sizes", "weights", "noise_stds"))
    *_, flags = engine._find(task)
    header = [*batch["seeds"].shape, weights.shape[1], len(sizes) - 1, batch["output_tanh"]]
    header += [flags, task.max_steps, noise is not None]
    arrays = [
        np.array(header, np.int64),
        np.array([batch["time_scale"] or 0.0]),
        np.array(sizes, np.int32),
        weights.astype(np.float32),
        np.empty(0) if noise is None else noise,
        batch["designs"],
        batch["reward_factors"],
        batch["seeds"].astype(np.uint64),
    ]
    path.write_bytes(b"".join(array.tobytes() for array in arrays))


@cache
def program_for(machine, folder):
    """Compiles the engine with tests/native/episodes.cpp; the command that runs it."""
    tools = [ARM[0], "qemu-aarch64"] if machine == "arm" else ["node"]
    for tool in tools:
        if shutil.which(tool) is None:
            pytest.skip(f"needs {tool}")
    if machine == "wasm" and find_spec("ziglang") is None:
        pytest.skip("needs ziglang (pip install -c requirements-extras.lock ziglang)")
    program = folder / f"episodes-{machine}"
    compiler = ARM if machine == "arm" else WASM
    subprocess.run([*compiler, *FLAGS, *SOURCES, "-o", program], check=True)
    if machine == "arm":
        return ["qemu-aarch64", program]
    return ["node", "--no-warnings", "-e", RUN_WASM, program]


def run_there(machine, folder, task, batch):
    """Returns and steps as of `rollout`, but flat."""
    command = program_for(machine, folder)
    source, target = folder / "batch", folder / "returns"
    write(source, task, batch)
    if machine == "wasm":
        subprocess.run([*command, task.name, source, target], check=True)
    else:
        with open(source) as stdin, open(target, "w") as stdout:
            subprocess.run([*command, task.name], stdin=stdin, stdout=stdout, check=True)
    lines = [line.split() for line in target.read_text().splitlines()]
    return [float.fromhex(total) for total, _ in lines], [int(steps) for _, steps in lines]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("programs")


@pytest.mark.parametrize("name", ["biped-hardcore-morphology", "ant-morphology"])
@pytest.mark.parametrize("machine", ["arm", "wasm"])
def test_episodes_elsewhere_have_the_bits_of_x86(machine, folder, name):
    task = replace(engine_task(get_experiment(name).env_id)[0], max_steps=150)
    batch = batch_of(name, candidates=8, rollouts=2)
    returns, steps = engine.rollout(task, **batch)
    found = run_there(machine, folder, task, batch)
    assert found == (returns.ravel().tolist(), steps.ravel().tolist())


def main(candidates):
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for machine, name in product(("arm", "wasm"), EXPERIMENTS):
            task, _ = engine_task(get_experiment(name).env_id)
            batch = batch_of(name, candidates, rollouts=1)
            returns, steps = engine.rollout(task, **batch)
            found = zip(*run_there(machine, Path(folder), task, batch), strict=True)
            here = zip(returns.ravel().tolist(), steps.ravel().tolist(), strict=True)
            differ = sum(a != b for a, b in zip(found, here, strict=True))
            print(f"{machine}, {name}: {differ} of {candidates} differ", int(steps.sum()), "steps")
            wrong += differ
    return wrong > 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
