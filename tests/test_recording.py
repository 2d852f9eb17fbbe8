"""Recordings: what is written is what is read, whatever happened to the file in between."""

import base64
import errno
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from PIL import Image

from designrl.bodies import GROUND_COLOR
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS, get_experiment
from designrl.policy import Agent
from designrl.provenance import versions
from designrl.recording import (
    Generation,
    RecordingError,
    RolloutWriter,
    RunWriter,
    describe,
    read,
    record_rollout,
    schema_pb2,
    table,
    thin,
)
from designrl.recording.film import PICTURES
from designrl.recording.mcap_file import McapFile
from designrl.simulation import Simulator

EXPERIMENT = EXPERIMENTS["biped-morphology"]
ABOUT = {"experiment": EXPERIMENT.name, "seed": "7", "host": "Zürich", "settings": {"a": [1, 2.5]}}
HELD = {**ABOUT, "settings": '{"a": [1, 2.5]}'}  # what is not text becomes JSON


def generation(index: int, population: int = 6, rollouts: int = 3) -> dict:
    """A generation as a training run records it; a function of its index."""
    rng = np.random.default_rng(index)
    shape = population, rollouts
    return {
        "index": index,
        "mu": rng.normal(size=EXPERIMENT.num_parameters),
        "sigma": rng.uniform(0.01, 0.1, EXPERIMENT.num_parameters),
        "returns": rng.normal(size=shape) * 300,
        "steps": rng.integers(1, 2000, shape),
        "seeds": rng.integers(0, 2**63, shape),
        "seconds": 0.5 * index,
        "total_steps": 10**9 * (index + 1),
        "cpu_seconds": 1.5 * index,
    }


def evaluation(index: int) -> dict:
    rng = np.random.default_rng([index, 1])
    return {
        "index": index,
        "scores": rng.normal(size=20) * 300,
        "steps": rng.integers(1, 2000, 20),
        "seeds": rng.integers(0, 2**63, 20),
        "kept": index % 2 == 0,
    }


def full_disk(after: int):
    """os.pwrite on a disk that has room for so many bytes of the file."""
    pwrite = os.pwrite

    def write(descriptor, data, offset):
        if offset >= after:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return pwrite(descriptor, bytes(data)[: after - offset], offset)

    return write


def write_run(path, indices, **kwargs):
    with RunWriter(path, ABOUT, **kwargs) as writer:
        for index in indices:
            writer.generation(Generation(**generation(index)))
            if index % 5 == 4:
                writer.evaluation(**evaluation(index))
            if index % 2:
                writer.flush()  # as time would have it
        writer.close()  # so that it is closed twice


def count_by_others(path) -> int:
    """How many messages a file has to a reader that is not ours, which believes its index."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        count = sum(1 for _ in reader.iter_messages())
        assert count == reader.get_summary().statistics.message_count
        return count


def random_agent(name: str) -> Agent:
    experiment = EXPERIMENTS[name]
    parameters = np.random.default_rng(1).normal(size=experiment.num_parameters) * 0.3
    return Agent(experiment, parameters, metadata={"seed": 1, "versions": versions()})


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "generations.mcap"
    write_run(path, range(12))
    return path


@pytest.fixture(scope="module")
def rollout(tmp_path_factory):
    path = tmp_path_factory.mktemp("rollout") / "rollout.mcap"
    record_rollout(random_agent("biped-hardcore-morphology"), path, seed=3)
    return path


def test_each_field_of_the_schema_has_a_comment():
    text = (Path(schema_pb2.__file__).parent / "schema.proto").read_text()
    assert not re.findall(r"= \d+;$", text, re.M)


def test_the_generated_module_is_what_make_proto_writes(tmp_path):
    pytest.importorskip("grpc_tools", reason="needs grpcio-tools (`make proto` installs it)")
    module = Path(schema_pb2.__file__)
    root = module.parents[2]
    command = [sys.executable, "-m", "grpc_tools.protoc", f"-I{root}", f"--python_out={tmp_path}"]
    subprocess.run([*command, module.with_name("schema.proto")], check=True)
    assert (tmp_path / module.relative_to(root)).read_bytes() == module.read_bytes()


# ------------------------------------------------------------------------------- a run


def test_run_reads_back_to_the_bit(run):
    recording = read(run)
    assert recording.kind == "run" and recording.complete and recording.problem is None
    assert recording.metadata == HELD and "incomplete" not in describe(run)
    each = dict.fromkeys(("/design", "/distribution", "/returns", "/summary"), 12)
    seldom = {"/evaluation": 2, "/log": 2, "/body": 3, "/original": 1}
    assert recording.topics == {**each, **seldom} and count_by_others(run) == 4 * 12 + 8
    assert np.array_equal(recording.generations, np.arange(12))
    written, evaluated = [generation(i) for i in range(12)], [evaluation(i) for i in (4, 9)]
    assert recording.array("/body", "sequence").tolist() == [0, 4, 9]
    assert re.match(r"generation 4: -?\d+\.\d ± ", recording.first("/log").message)
    for topic, expected, fields in (
        ("/distribution", written, ("mu", "sigma")),
        ("/returns", written, ("returns", "steps", "seeds")),
        ("/summary", written, ("seconds", "total_steps", "cpu_seconds")),
        ("/evaluation", evaluated, ("scores", "steps", "seeds", "kept")),
    ):
        for field in fields:
            found = recording.array(topic, field)
            assert np.array_equal(found, np.array([row[field] for row in expected], found.dtype))
    assert recording.array("/distribution", "mu").dtype == np.float32
    times = recording.array("/summary", "log_time")
    assert (np.diff(times) >= 0).all() and abs(times[-1] / 1e9 - time.time()) < 600
    with pytest.raises(RecordingError, match="no topic '/nonsense'"):
        recording.names("/nonsense")
    with pytest.raises(RecordingError, match="no field 'nonsense' of numbers; it has generation, "):
        recording.array("/summary", "nonsense")


def test_summary_and_design_follow_from_the_distribution(run):
    recording, space = read(run), EXPERIMENT.design
    fitness = recording.array("/returns", "returns").mean(axis=2)
    for field, of_all in (("mean", np.mean), ("sd", np.std), ("best", np.max), ("worst", np.min)):
        assert np.array_equal(recording.array("/summary", field), of_all(fitness, axis=1))
    mu, sigma = (
        recording.array("/distribution", field)[:, -space.size :].astype(np.float64)
        for field in ("mu", "sigma")
    )
    assert recording.names("/design") == list(space.names)
    assert recording.unit("/design") == space.unit
    for field, parameters in (("dimensions", mu), ("lower", mu - sigma), ("upper", mu + sigma)):
        expected = space.dimensions(space.scales(parameters))
        assert np.array_equal(recording.array("/design", field), expected)


# ---------------------------------------------------------------------- crashes and resumes


def test_a_killed_process_leaves_a_whole_file(tmp_path):
    path = tmp_path / "run.mcap"
    script = (
        "import sys, time; sys.path[:0] = ['tests']\n"
        "from test_recording import *\n"
        f"writer = RunWriter({str(path)!r}, ABOUT)\n"
        "for index in range(10**6):\n"
        "    writer.generation(Generation(**generation(index))); writer.flush()\n"
        "    print(index, flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    done = [int(process.stdout.readline()) for _ in range(40)][-1]
    process.send_signal(signal.SIGKILL)
    process.wait()
    recording = read(path)
    last = len(recording.generations) - 1
    assert last >= done and np.array_equal(recording.generations, np.arange(last + 1))
    assert recording.problem is None and not recording.complete
    assert count_by_others(path) == 4 * (last + 1) + 2  # the first bodies
    why = "incomplete (the run has not ended, or was killed)"
    assert f"{why}: it goes up to generation {last}" in describe(path)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupt_waits_until_the_record_is_whole(number, tmp_path, monkeypatch):
    path, pwrite = tmp_path / "run.mcap", os.pwrite
    before = signal.signal(number, signal.default_int_handler)  # as `designrl train` does

    def interrupted(*arguments):
        monkeypatch.setattr(os, "pwrite", pwrite)
        signal.raise_signal(number)
        return pwrite(*arguments)

    with pytest.raises(KeyboardInterrupt), RunWriter(path, ABOUT) as writer:
        for index in range(4):
            writer.generation(Generation(**generation(index)))
            monkeypatch.setattr(os, "pwrite", interrupted)
            with pytest.raises(KeyboardInterrupt) as interrupt:
                writer.flush()
        raise interrupt.value
    signal.signal(number, before)
    recording = read(path)
    assert recording.problem is None and recording.generations.tolist() == [0, 1, 2, 3]
    assert count_by_others(path) == 18 and not recording.complete
    assert "incomplete (the run was stopped): it goes up to generation 3" in describe(path)


@pytest.mark.parametrize(
    ("kind", "topic", "field"),
    [("run", "/returns", "returns"), ("rollout", "/observation", "values")],
)
def test_cut_anywhere_a_file_is_read_up_to_there(kind, topic, field, request, tmp_path):
    source, path = request.getfixturevalue(kind), tmp_path / "cut.mcap"
    data, whole = source.read_bytes(), read(source)
    expected = whole.array(topic, field)
    lengths, nothing = set(), 0
    for cut in [50, *np.random.default_rng(0).integers(0, len(data), 200)]:
        path.write_bytes(data[:cut])
        try:
            recording = read(path)
        except RecordingError as error:
            assert cut < 8 and "not an MCAP file" in str(error)
            continue
        assert recording.problem and not recording.complete
        if recording.topics or recording.metadata_records:
            assert "incomplete" in describe(path)
            # Where it came from is said before anything else; only a rollout's score is not.
            assert recording.kind == kind and "seed" in recording.metadata
            assert recording.metadata.items() <= whole.metadata.items()
        else:
            with pytest.raises(RecordingError, match=r"cut\.mcap holds nothing to tell of"):
                describe(path)
            nothing += 1
        found = recording.array(topic, field) if recording.topics.get(topic) else expected[:0]
        assert np.array_equal(found, expected[: len(found)])
        lengths.add(len(found))
    # This episode fits in a single chunk.
    assert nothing and len(lengths) > (3 if kind == "run" else 0)


def write_others(path, topics=("/thing",), metadata=None, schema="other.Thing", about=None, **how):
    """A recording of another program with three messages per topic."""
    writer = Writer(str(path), **how)
    writer.start()
    if metadata:
        writer.add_metadata("run", metadata)
    number = writer.register_schema(schema, "jsonschema", b"{}") if schema else 0
    for topic in topics:
        channel = writer.register_channel(topic, "json", number, about or {})
        for time_ in range(3):
            writer.add_message(channel, time_, b"{}", time_)
    writer.finish()


@pytest.mark.parametrize(
    "options",
    [
        *({"compression": way, "use_chunking": c} for way in CompressionType for c in (1, 0)),
        # Topics and metadata of our names do not make a file ours.
        {"topics": ["/summary", "/tf", "/reward"], "metadata": {"robot": "other"}},
        {"schema": ""},
    ],
)
def test_files_of_other_programs_are_described(options, tmp_path):
    path = tmp_path / "other.mcap"
    write_others(path, **options)
    recording = read(path)
    assert recording.topics == dict.fromkeys(options.get("topics", ["/thing"]), 3)
    assert recording.kind == "unknown" and recording.metadata == {} and recording.complete
    assert len(recording.generations) == 0
    text = describe(path)
    assert "not a recording of designrl but an MCAP file of another program" in text
    assert "incomplete" not in text
    for topic in recording.topics:
        assert f"{topic}: 3 messages" in text
        with pytest.raises(RecordingError, match="no field 'x' of numbers; it has log_time"):
            recording.array(topic, "x")
        with pytest.raises(RecordingError, match=f"unknown type '{options.get('schema', 'other')}"):
            list(recording.messages(topic))


@pytest.mark.parametrize(
    ("held", "resume"), [(12, 0), (12, 1), (12, 5), (12, 12), (12, 20), (0, 6), (4, 6), (None, 6)]
)
def test_a_resumed_run_has_every_generation_once(held, resume, tmp_path, capsys):
    path = tmp_path / "run.mcap"
    if held is not None:
        write_run(path, range(held))
    stop = max(resume, 12) + 3
    write_run(path, range(resume, stop), resume_generation=resume)
    recording, kept = read(path), min(resume, held or 0)
    expected = [*range(kept), *range(resume, stop)]
    assert recording.generations.tolist() == expected
    found = recording.array("/returns", "returns")
    assert np.array_equal(found, [generation(i)["returns"] for i in expected])
    evaluated = recording.array("/evaluation", "generation").tolist()
    assert evaluated == [i for i in expected if i % 5 == 4]
    assert (np.diff(recording.array("/summary", "log_time")) >= 0).all()
    assert recording.kind == "run" and recording.complete and recording.metadata == HELD
    assert recording.topics["/original"] == 1

    gap = f"{resume - kept} of the generations {kept} to {resume - 1} are missing"
    about, line, told = {"generation": str(resume)}, "", "are missing" in describe(path)
    if kept < resume:
        about["missing"] = gap
        line = f"{path}: {gap} (the file was cut or removed); going on\n"
        assert f"{resume - kept} generations are missing" in describe(path)
    assert capsys.readouterr().err == line and told == bool(line)
    middle = [("resumed", about)] if resume else []  # from the start, it is a new recording
    assert recording.metadata_records == [("run", HELD), *middle, ("end", {"finished": "true"})]


def test_metadata_that_repeats_a_key_gets_a_name_of_its_own(tmp_path):
    path = tmp_path / "run.mcap"
    for resume in (0, 2, 4, 6):
        write_run(path, range(resume, resume + 3), resume_generation=resume)
    names = [name for name, _ in read(path).metadata_records]
    assert names == ["run", "resumed", "resumed 2", "resumed 3", "end"]
    assert read(path).topics["/original"] == 1


def test_a_run_resumes_from_a_file_that_was_cut(run, tmp_path):
    data, path = run.read_bytes(), tmp_path / "run.mcap"
    for cut in np.random.default_rng(1).integers(8, len(data), 10):
        path.write_bytes(data[:cut])
        held = len(read(path).generations)
        resume = min(held, 6)
        write_run(path, range(resume, 8), resume_generation=resume)
        recording = read(path)
        assert recording.generations.tolist() == list(range(8)) and recording.complete
        assert recording.metadata == HELD


def test_a_resume_that_fails_leaves_the_old_file(run, tmp_path, monkeypatch):
    path = tmp_path / "run.mcap"
    path.write_bytes(run.read_bytes())
    monkeypatch.setattr(os, "pwrite", full_disk(after=20_000))
    with pytest.raises(RecordingError, match="No space left on device.*recorded before is intact"):
        RunWriter(path, ABOUT, resume_generation=9)
    assert path.read_bytes() == run.read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_full_disk_is_one_sentence_and_costs_no_generation(tmp_path, monkeypatch):
    path = tmp_path / "run.mcap"
    monkeypatch.setattr(os, "pwrite", full_disk(after=150_000))
    done = -1
    with (
        pytest.raises(RecordingError, match=r"cannot be written \(No space left on device\)"),
        RunWriter(path, ABOUT) as writer,
    ):
        for index in range(100):
            writer.generation(Generation(**generation(index)))
            writer.flush()
            done = index
    assert done >= 3
    recording = read(path)
    assert recording.problem is None and recording.generations[-1] == done
    assert count_by_others(path) == 4 * (done + 1) + 2


def test_what_cannot_be_recorded_is_refused_and_leaves_no_file(rollout, tmp_path, monkeypatch):
    with pytest.raises(RecordingError, match=r"generations\.mcap"):
        thin(rollout, tmp_path / "thin.mcap")
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match=r"file/run\.mcap cannot be written"):
        RunWriter(tmp_path / "file" / "run.mcap", ABOUT)
    with pytest.raises(InputError, match="the seed is -1; it must be a whole number from 0 on"):
        record_rollout(random_agent("biped"), tmp_path / "rollout.mcap", seed=-1)
    monkeypatch.setattr(os, "pwrite", full_disk(after=1000))
    with pytest.raises(RecordingError, match="No space left") as failure:
        record_rollout(random_agent("biped"), tmp_path / "rollout.mcap", seed=0)
    assert "intact" not in str(failure.value)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


# ----------------------------------------------------------------------------- thinning


def test_thinning_drops_messages_and_rounds_nothing(run, tmp_path):
    path = tmp_path / "thin.mcap"
    keep = {"/distribution": 2, "/returns": 3, "/summary": 5, "/design": 60, "/evaluation": 1}
    thin(run, path, keep)
    whole, thinned = read(run), read(path)
    for topic, field, rows in (
        ("/distribution", "generation", [0, 11]),
        ("/distribution", "mu", [0, 11]),
        ("/distribution", "sigma", [0, 11]),
        ("/returns", "returns", [0, 6, 11]),
        ("/summary", "mean", [0, 3, 6, 8, 11]),
        ("/design", "dimensions", slice(None)),
        ("/evaluation", "mean", slice(None)),
    ):
        assert np.array_equal(thinned.array(topic, field), whole.array(topic, field)[rows])
    episodes = [len(row) for row in thinned.array("/evaluation", "scores")]
    assert episodes == [len(whole.array("/evaluation", "scores")[0]), *[0] * (len(episodes) - 1)]
    record = dict(thinned.metadata_records)["thinned"]
    assert record["of_generations"] == "12" and '"/returns": 3' in record["kept"]
    assert thinned.complete and thinned.metadata == whole.metadata
    assert "thinned" in describe(path) and "missing" not in describe(path)


def test_thinning_spreads_over_generations_also_where_a_thinned_run_went_on(run, tmp_path):
    once, twice = tmp_path / "generations.mcap", tmp_path / "thin.mcap"
    thin(run, once, {"/design": 2})
    with RunWriter(once, ABOUT, resume_generation=12) as writer:
        for index in range(12, 24):
            writer.generation(Generation(**generation(index)))
    assert read(once).array("/design", "sequence").tolist() == [0, *range(11, 24)]
    thin(once, twice, {"/design": 4})
    assert read(twice).array("/design", "sequence").tolist() == [0, 11, 15, 23]
    thin(once, twice, {"/design": 6})  # as many, though none of 1 to 10 is there
    assert read(twice).array("/design", "sequence").tolist() == [0, 11, 13, 16, 20, 23]


# ---------------------------------------------------------------------------- rollouts


@pytest.mark.parametrize("name", ["biped", "biped-hardcore-morphology", "ant-morphology"])
def test_a_rollout_is_the_episode_that_an_evaluation_runs(name, tmp_path):
    agent, path = random_agent(name), tmp_path / "rollout.mcap"
    score = record_rollout(agent, path, seed=5)
    with Simulator(name, backend="reference") as simulator:
        expected = simulator.rollout(agent.parameters[None], np.array([[5]]))
    assert score == expected.returns[0, 0]

    recording = read(path)
    assert recording.kind == "rollout" and recording.complete
    about = recording.metadata
    assert about["experiment"] == name and float(about["score"]) == score
    assert json.loads(about["agent"])["seed"] == 1
    terms, reward, total = (recording.array("/reward", f) for f in ("terms", "reward", "total"))
    assert np.allclose(terms.sum(axis=1), reward) and total[-1] == score

    # The same episode again, compared with what was recorded of it.
    env = gymnasium.make(agent.experiment.env_id)
    steps = list(agent.steps(env, agent.start(env, 5)))
    assert len(steps) == expected.steps[0, 0]
    for topic, field in (("/observation", "observation"), ("/action", "action")):
        seen = [getattr(step, field) for step in steps]
        assert np.array_equal(recording.array(topic, "values"), seen)
    inner, body = env.unwrapped, agent.experiment.body
    assert recording.names("/observation") == list(body.observations)
    assert recording.names("/action") == recording.names("/joints") == list(body.joints)
    assert recording.array("/joints", "angles")[-1].tolist() == body.joint_states(inner)[0]
    assert recording.array("/contacts", "touching")[-1].tolist() == body.contacts(inner)
    assert recording.topics["/tf"] == len(steps) + 1
    env.close()


def test_terrain_holds_the_course_with_its_obstacles(rollout):
    terrain = next(read(rollout).messages("/terrain"))
    assert len(terrain.x) == 200 and len(terrain.obstacles) > 5
    env = gymnasium.make("designrl/BipedalWalkerHardcore-v0")
    env.reset(seed=3)
    assert list(terrain.x) == list(env.unwrapped.terrain_x)
    assert np.array_equal(terrain.z, env.unwrapped.terrain_y)
    boxes = np.array([(o.x_max - o.x_min, o.z_max - o.z_min) for o in terrain.obstacles])
    assert (boxes > 0.4).all() and (boxes < 2.0).all()


@pytest.fixture
def stepped():
    """A walker, and what its first step gives to `RolloutWriter.step`."""
    with closing(gymnasium.make("designrl/BipedalWalker-v0")) as env:
        seen, _ = env.reset(seed=0)
        action = np.zeros(4, np.float32)
        _, reward, _, _, info = env.step(action)
        yield env, {"observation": seen, "action": action, "reward": reward, "info": info}


def test_reward_terms_are_recorded_under_their_names(stepped, tmp_path):
    env, step = stepped
    reversed_terms = dict(reversed(step["info"]["reward_terms"].items()))
    with RolloutWriter(tmp_path / "x.mcap", env, ABOUT) as writer:
        writer.step(**step)
        writer.step(**{**step, "info": {"reward_terms": reversed_terms}})
    first, second = read(tmp_path / "x.mcap").array("/reward", "terms").tolist()
    assert first == second == list(step["info"]["reward_terms"].values())


@pytest.mark.parametrize(
    ("at", "change", "said"),
    [
        (1, {"info": {}}, "lacks the reward term 'progress'"),
        (1, {"info": {"reward_terms": {"x": 1.0}}}, "lacks the reward term 'progress'"),
        (1, {"info": None}, "no number"),
        (0, {"info": None}, "no number"),
        (1, {"observation": np.zeros(3)}, r"\(3,\) for /observation values, .* \(24,\)"),
        (0, {"observation": np.zeros(3)}, r"\(3,\) for /observation values, .* \(24,\)"),
        (1, {"action": np.zeros((1, 4))}, r"\(1, 4\) for /action values, .* \(4,\)"),
        (0, {"action": np.zeros((1, 4))}, r"\(1, 4\) for /action values, .* \(4,\)"),
        (1, {"action": None}, "/action values"),
        (0, {"action": None}, "/action values"),
        (1, {"reward": "much"}, "no number"),
        (0, {"reward": "much"}, "no number"),
        (1, {"reward": np.nan}, "a reward of nan"),
        (0, {"reward": np.nan}, "a reward of nan"),
    ],
)
def test_a_step_unlike_the_first_is_refused_and_leaves_nothing(at, change, said, stepped, tmp_path):
    env, step = stepped

    def record():
        with RolloutWriter(tmp_path / "x.mcap", env, ABOUT) as writer:
            for _ in range(at):
                writer.step(**step)
            writer.step(**{**step, **change})

    with pytest.raises(RecordingError, match=f"^step {at} of .*{said}"):
        record()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "metadata", [{"a": np.zeros(2)}, {"a": "\ud800"}, {3: "a"}, None], ids=["array", "?", "3", "0"]
)
def test_metadata_that_cannot_be_recorded_is_refused(metadata, stepped, tmp_path):
    with pytest.raises(RecordingError, match=r"metadata for .*x\.mcap cannot be recorded"):
        RolloutWriter(tmp_path / "x.mcap", stepped[0], metadata)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["biped", "ant"])
def test_an_environment_that_was_not_reset_is_refused(name, tmp_path):
    env = gymnasium.make(get_experiment(name).env_id)
    with pytest.raises(RecordingError, match="give an environment that has been reset"):
        RolloutWriter(tmp_path / "x.mcap", env, ABOUT)
    env.close()
    assert not list(tmp_path.iterdir())


def test_steps_outside_of_the_writers_with_are_refused(stepped, tmp_path):
    env, step = stepped
    writer = RolloutWriter(tmp_path / "x.mcap", env, {**ABOUT, "body": {"without": "unit"}})
    with pytest.raises(RecordingError, match="outside of `with"):
        writer.step(**step)
    assert not list(tmp_path.iterdir())
    with writer:
        pass
    with pytest.raises(RecordingError, match="outside of `with"):
        writer.step(**step)
    assert "  0 steps\n" in describe(writer._file.path)
    with pytest.raises(RecordingError, match="rollout without a step"):
        table(writer._file.path)
    recording = read(writer._file.path)
    assert recording._repr_html_() is None and "without steps" in repr(recording)


@pytest.mark.parametrize("name", ["biped-hardcore-morphology", "ant"])
def test_a_notebook_shows_a_rollout_as_a_film(name, tmp_path):
    record_rollout(random_agent(name), tmp_path / "x.mcap", seed=0, steps=20)
    recording = read(tmp_path / "x.mcap")
    data = re.search(r'base64,(.*)"', recording._repr_html_())[1]
    film = Image.open(io.BytesIO(base64.b64decode(data)))
    assert film.n_frames == np.ceil(recording.seconds * PICTURES)
    first, last = (
        np.asarray(film.convert("RGB")) for i in (0, 1) if not film.seek(-i % film.n_frames)
    )
    ground = (np.abs(first.astype(int) - GROUND_COLOR).max(axis=2) < 40).mean()
    assert 0.01 < ground < 0.9 and (first != last).any()


def test_two_writers_of_one_path_do_not_mix(tmp_path):
    path = tmp_path / "x.mcap"
    files = {number: McapFile(path) for number in "12"}
    for number, file in files.items():
        file.metadata("from", {"file": number})
    for number, file in files.items():
        file.publish()
        assert read(path).metadata_records == [("from", {"file": number})]
    for file in files.values():
        file.close()
    assert [p.name for p in tmp_path.iterdir()] == ["x.mcap"]
