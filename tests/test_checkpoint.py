import json
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from designrl.author import describe as describe_author
from designrl.author import load_author
from designrl.checkpoint import STATE_FORMAT, describe, save, write_tensors
from designrl.errors import InputError
from designrl.experiments import AUTHOR_ANT_NETWORK, EXPERIMENTS, get_experiment
from designrl.files import file_hash
from designrl.names import load
from designrl.policy import Agent


def make_agent(name="biped-morphology", network=None, **metadata):
    experiment = get_experiment(name)
    size = experiment.parameters_with(network or experiment.network)
    parameters = np.random.default_rng(0).standard_normal(size)
    return Agent(experiment, parameters, network, metadata)


@pytest.mark.parametrize(
    ("name", "network"), [*((name, None) for name in EXPERIMENTS), ("ant", AUTHOR_ANT_NETWORK)]
)
def test_what_is_saved_is_loaded(name, network, tmp_path):
    agent = make_agent(name, network, seed=3, generation=25, settings={"population": 4})
    save(agent, tmp_path / "a.safetensors")
    loaded = load(tmp_path / "a.safetensors")
    np.testing.assert_array_equal(loaded.parameters, agent.parameters)
    assert (loaded.experiment, loaded.network) == (agent.experiment, agent.network)
    assert agent.metadata.items() <= loaded.metadata.items()
    text = describe(tmp_path / "a.safetensors")
    assert name in text and "generation   25\n" in text


def test_equal_agents_give_equal_bytes_in_every_process(tmp_path):
    save(make_agent(seed=1, b=2, c=3, d=4), tmp_path / "here.safetensors")
    code = (
        "import sys; sys.path.insert(0, 'tests'); from test_checkpoint import *; "
        f"save(make_agent(seed=1, b=2, c=3, d=4), {str(tmp_path / 'there.safetensors')!r})"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert file_hash(tmp_path / "here.safetensors") == file_hash(tmp_path / "there.safetensors")


def test_every_truncation_of_a_checkpoint_is_refused_in_one_sentence(tmp_path):
    save(make_agent(), tmp_path / "a.safetensors")
    data = (tmp_path / "a.safetensors").read_bytes()
    for size in [*range(0, 600, 7), len(data) // 2, len(data) - 1]:
        (tmp_path / "cut.safetensors").write_bytes(data[:size])
        with pytest.raises(InputError, match=r"cut\.safetensors") as caught:
            load(tmp_path / "cut.safetensors")
        assert "\n" not in str(caught.value)


def test_flipped_bits_are_noticed(tmp_path):
    save(make_agent(), tmp_path / "a.safetensors")
    data = (tmp_path / "a.safetensors").read_bytes()
    rng = np.random.default_rng(0)
    places = [*rng.integers(0, 700, 300), *rng.integers(0, len(data), 300), len(data) - 1]
    flips = [(place, 1 << rng.integers(8)) for place in places]
    key = data.index(b"sha256")  # a hash of another name is none
    flips += [(place, 1 << bit) for place in range(key, key + 6) for bit in range(8)]
    for place, bit in flips:
        changed = bytearray(data)
        changed[place] ^= bit
        (tmp_path / "changed.safetensors").write_bytes(changed)
        with pytest.raises(InputError, match=r"changed\.safetensors"):
            load(tmp_path / "changed.safetensors")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "not a 2018 weights file"),
        ("[[1, 2], 3]", "has 2804 parameters"),
        ("[[1, 2]", "not a 2018 weights file"),
        ('{"a": 1}', "not a 2018 weights file"),
        ("[[1, 2]]", "has 2804 parameters"),
        ("[[1, 2], 3, 4]", "not a 2018 weights file"),
        ("[]", "not a 2018 weights file"),
        (json.dumps([[[1.0]] * 2804, 1]), "has 2804 parameters"),
        (json.dumps([["a"] * 2804, 1]), "not a 2018 weights file"),
        (json.dumps([[0.0] * 2803 + [float("nan")], 1]), "parameter 2803 is not a finite"),
        (json.dumps([[1e300] * 2804, 1]), "parameter 0 is not a finite"),
        (json.dumps([[0.0] * 2804, None]), "not a 2018 weights file"),
    ],
)
def test_a_wrong_2018_file_is_refused_by_name(tmp_path, content, words):
    (tmp_path / "biped.json").write_text(content)
    with pytest.raises(InputError, match=rf"biped\.json.*{words}"):
        load_author(tmp_path / "biped.json", get_experiment("biped"))


def test_a_2018_file_is_imported_in_its_order(tmp_path):
    parameters = np.arange(2812) / 1000
    (tmp_path / "a.json").write_text(json.dumps([parameters.tolist(), 12.5]))
    agent = load(tmp_path / "a.json", "biped-morphology")
    np.testing.assert_array_equal(agent.parameters, parameters)
    np.testing.assert_allclose(agent.design, 1 + 0.75 * np.tanh(parameters[-8:]))
    assert agent.metadata["score"] == 12.5
    (tmp_path / "mean.json").write_text(json.dumps([parameters.tolist()]))
    mean = load(tmp_path / "mean.json", "biped-morphology")
    np.testing.assert_array_equal(mean.parameters, parameters)
    assert "score" not in mean.metadata
    assert "2812 numbers, no score; experiments" in describe_author(tmp_path / "mean.json")


def test_a_run_without_an_agent_says_so(tmp_path):
    (tmp_path / "generations.mcap").touch()
    for name in (tmp_path, tmp_path / "best.safetensors"):
        with pytest.raises(InputError, match=f"{tmp_path} has no agent; a run keeps"):
            load(name)


def test_the_wrong_file_is_refused_by_name(tmp_path):
    save(make_agent("biped"), tmp_path / "a.safetensors")
    with pytest.raises(InputError, match="is of experiment biped, not biped-morphology"):
        load(tmp_path / "a.safetensors", "biped-morphology")
    with pytest.raises(InputError, match="there is no .*absent"):
        load(tmp_path / "absent.safetensors")
    with pytest.raises(InputError, match="holds no run"):
        load(tmp_path)
    (tmp_path / "a.json").write_text("[[], 0]")
    with pytest.raises(InputError, match="the name of its experiment"):
        load(tmp_path / "a.json")


def test_what_is_no_agent_is_called_what_it_is(tmp_path):
    state, recording, text = (tmp_path / name for name in ("state.safetensors", "a.mcap", "a.txt"))
    write_tensors(state, {}, {}, STATE_FORMAT)
    with pytest.raises(InputError, match=r"is a training state, not an agent; name best\.safeten"):
        load(state)
    recording.write_bytes(b"\x89MCAP0\r\n" + bytes(2**23))
    with pytest.raises(InputError, match="a.mcap is a recording, not a checkpoint; open it with"):
        load(recording)
    text.write_text("version https://git-lfs.github.com/spec/v1")
    with pytest.raises(InputError, match=r"a\.txt is not a designrl checkpoint 1 file; get it"):
        load(text)


def test_no_space_leaves_the_old_file(tmp_path, monkeypatch):
    save(make_agent(), tmp_path / "a.safetensors")
    before = file_hash(tmp_path / "a.safetensors")

    def full(_descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(InputError, match="No space left on device"):
        save(make_agent(seed=7), tmp_path / "a.safetensors")
    assert file_hash(tmp_path / "a.safetensors") == before
    assert [path.name for path in tmp_path.iterdir()] == ["a.safetensors"]


def test_a_checkpoint_has_the_limits_of_its_body(tmp_path):
    experiment = get_experiment("biped-morphology")
    parameters = np.random.default_rng(0).standard_normal(experiment.num_parameters)
    space = replace(experiment.body.design, form="lognormal", limit=3.0)
    save(Agent(experiment, parameters, space=space), tmp_path / "a.safetensors")
    found = load(tmp_path / "a.safetensors")
    np.testing.assert_array_equal(found.scales, np.clip(np.exp(parameters[-8:]), 1 / 3, 3))
    assert found.env_kwargs == {"design_bounds": [1 / 3, 3.0]}
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(found)).scales, found.scales)
    assert ", lognormal" in describe(tmp_path / "a.safetensors")
    save(Agent(experiment, parameters), tmp_path / "b.safetensors")
    assert load(tmp_path / "b.safetensors").env_kwargs == {}
    assert "limits" not in load(tmp_path / "b.safetensors").metadata
    for limits in (3, {"width": 3}, {"form": "cubic"}, {"bounds": [2, 3]}):
        wrong = Agent(experiment, parameters, metadata={"limits": limits})
        save(wrong, tmp_path / "c.safetensors")
        with pytest.raises(InputError, match=r"c.safetensors cannot be used: (the|design) "):
            load(tmp_path / "c.safetensors")
        (tmp_path / "c.safetensors").unlink()
