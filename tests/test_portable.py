"""The portable engine on other machines: 64-bit ARM and WebAssembly give x86-64's bits."""

import platform
import shutil
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from designrl import engine
from designrl.checkpoint import PRETRAINED, load
from designrl.envs import engine_task
from designrl.experiments import get_experiment
from designrl.policy import noise_stds

ROOT = Path(__file__).parents[1]
NATIVE = ROOT / "designrl" / "engine" / "native"
SOURCES = [*NATIVE.glob("*/*.cpp"), ROOT / "tests" / "native" / "episodes.cpp"]
# Those of setup.py that the bits hang on, and what a machine without a C++ library needs.
FLAGS = [
    *("-std=c++17", "-O2", "-g0", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
    *("-fno-exceptions", "-fno-rtti", "-fno-threadsafe-statics", f"-I{NATIVE}"),
]
ARM = ["aarch64-linux-gnu-g++", "-static"]
WASM = [*(sys.executable, "-m", "ziglang", "c++"), "-target", "wasm32-wasi"]
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


def batch_of(name, candidates, rollouts, seed=0):
    """Arguments of `rollout` but the task: in turn a random agent and a published one."""
    experiment, rng = get_experiment(name), np.random.default_rng(seed)
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
def arm_program(folder):
    for tool in (ARM[0], "qemu-aarch64"):
        if shutil.which(tool) is None:
            pytest.skip(f"needs {tool}")
    program = folder / "episodes-arm"
    subprocess.run([*ARM, *FLAGS, *SOURCES, "-o", program], check=True)
    return ["qemu-aarch64", program]


@cache
def wasm_program(folder):
    if find_spec("ziglang") is None:
        pytest.skip("needs ziglang (pip install -c requirements-extras.lock ziglang)")
    if shutil.which("node") is None:
        pytest.skip("needs node")
    program = folder / "episodes.wasm"
    subprocess.run([*WASM, *FLAGS, *SOURCES, "-o", program], check=True)
    return ["node", "--no-warnings", "-e", RUN_WASM, program]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("programs")


@pytest.mark.parametrize(
    "name, candidates, rollouts",
    [("biped", 4, 2), ("biped-hardcore-morphology", 4, 3), ("ant", 2, 2), ("ant-morphology", 4, 2)],
)
@pytest.mark.parametrize("program", [arm_program, wasm_program], ids=["arm", "wasm"])
def test_episodes_elsewhere_have_the_bits_of_x86(
    folder, tmp_path, program, name, candidates, rollouts
):
    command = program(folder)
    task, _ = engine_task(get_experiment(name).env_id)
    batch = batch_of(name, candidates, rollouts)
    expected = engine.rollout(task, **batch)
    source, target = tmp_path / "batch", tmp_path / "returns"
    write(source, task, batch)
    if program is wasm_program:
        subprocess.run([*command, task.name, source, target], check=True)
    else:
        with open(source) as stdin, open(target, "w") as stdout:
            subprocess.run([*command, task.name], stdin=stdin, stdout=stdout, check=True)
    lines = [line.split() for line in target.read_text().splitlines()]
    assert [float.fromhex(total) for total, _ in lines] == expected[0].ravel().tolist()
    assert [int(steps) for _, steps in lines] == expected[1].ravel().tolist()
