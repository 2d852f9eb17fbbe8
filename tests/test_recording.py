"""Recordings: what is written is what is read, whatever happened to the file in between."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium
import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer

from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS
from designrl.policy import Agent
from designrl.provenance import versions
from designrl.recording import (
    RecordingError,
    RunWriter,
    describe,
    read,
    record_rollout,
    scan,
    schema_pb2,
    thin,
)
from designrl.recording.mcap_file import McapFile
from designrl.simulation import Simulator

EXPERIMENT = EXPERIMENTS["biped-morphology"]


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


def write_run(path, indices, **kwargs):
    with RunWriter(path, {"experiment": EXPERIMENT.name, "seed": "7"}, **kwargs) as writer:
        for index in indices:
            writer.generation(**generation(index))
            if index % 5 == 4:
                writer.evaluation(**evaluation(index))
            if index % 2:
                writer.flush()  # as time would have it


def count_by_others(path) -> int:
    """How many messages the index of a file says it has, to a reader that is not ours."""
    with path.open("rb") as file:
        return make_reader(file).get_summary().statistics.message_count


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
    record_rollout(random_agent("biped-hardcore-morphology"), path, seed=3, metadata={"note": "é"})
    return path


def test_the_generated_module_is_that_of_the_proto_file():
    text = (Path(schema_pb2.__file__).parent / "schema.proto").read_text()
    found = {
        (message, name, int(number))
        for message, body in re.findall(r"^message (\w+) \{(.*?)^\}", text, re.M | re.S)
        for name, number in re.findall(r"(\w+) = (\d+);", body)
    }
    assert found == {
        (message.name, field.name, field.number)
        for message in schema_pb2.DESCRIPTOR.message_types_by_name.values()
        for field in message.fields
    }
    assert not re.findall(r"= \d+;$", text, re.M), "each field has a comment"


# ------------------------------------------------------------------------------- a run


def test_run_reads_back_to_the_bit(run):
    recording = read(run)
    assert recording.kind == "run" and recording.complete and recording.problem is None
    assert recording.metadata == {"experiment": EXPERIMENT.name, "seed": "7"}
    assert recording.topics == {
        "/design": 12,
        "/distribution": 12,
        "/evaluation": 2,
        "/returns": 12,
        "/summary": 12,
    }
    assert np.array_equal(recording.generations, np.arange(12))
    written = [generation(i) for i in range(12)]
    for field in ("mu", "sigma"):
        found = recording.array("/distribution", field)
        assert found.dtype == np.float32
        assert np.array_equal(found, np.float32([g[field] for g in written]))
    for field in ("returns", "steps", "seeds"):
        found = recording.array("/returns", field)
        assert found.shape == (12, 6, 3)
        assert np.array_equal(found, [g[field] for g in written])
    for field in ("seconds", "total_steps", "cpu_seconds"):
        assert np.array_equal(recording.array("/summary", field), [g[field] for g in written])
    for field in ("scores", "steps", "seeds"):
        found = recording.array("/evaluation", field)
        assert np.array_equal(found, [evaluation(i)[field] for i in (4, 9)])
    assert recording.array("/evaluation", "kept").tolist() == [True, False]
    times = recording.array("/summary", "log_time")
    assert (np.diff(times) >= 0).all() and abs(times[-1] / 1e9 - time.time()) < 600


def test_summary_and_design_follow_from_the_distribution(run):
    recording, space = read(run), EXPERIMENT.design
    fitness = recording.array("/returns", "returns").mean(axis=2)
    assert np.array_equal(recording.array("/summary", "mean"), fitness.mean(axis=1))
    assert np.array_equal(recording.array("/summary", "sd"), fitness.std(axis=1))
    assert np.array_equal(recording.array("/summary", "best"), fitness.max(axis=1))
    mu, sigma = (
        recording.array("/distribution", field)[:, -space.size :].astype(np.float64)
        for field in ("mu", "sigma")
    )
    assert recording.names("/design") == list(space.names)
    assert recording.unit("/design") == space.unit
    for field, parameters in (("dimensions", mu), ("lower", mu - sigma), ("upper", mu + sigma)):
        expected = space.dimensions(space.scales(parameters))
        assert np.array_equal(recording.array("/design", field), expected)


def test_rollouts_per_candidate_may_change_in_a_run(tmp_path):
    with RunWriter(tmp_path / "run.mcap", {"experiment": EXPERIMENT.name}) as writer:
        writer.generation(**generation(0, rollouts=1))
        writer.generation(**generation(1, rollouts=4))
    found = read(tmp_path / "run.mcap").array("/returns", "returns")
    assert [a.shape for a in found] == [(6, 1), (6, 4)]
    assert np.array_equal(found[1], generation(1, rollouts=4)["returns"])


def test_other_programs_read_the_file(run):
    with run.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 12 * 4 + 2
        assert len(list(reader.iter_messages(topics=["/summary"]))) == 12
        assert [m.name for m in reader.iter_metadata()] == ["run", "end"]


def test_unknown_topics_and_fields_are_named(run):
    with pytest.raises(RecordingError, match="no topic '/nonsense'"):
        read(run).array("/nonsense", "x")
    with pytest.raises(RecordingError, match="no field 'nonsense'"):
        read(run).array("/summary", "nonsense")


def test_metadata_of_any_kind_is_kept(tmp_path):
    values = {"experiment": EXPERIMENT.name, "settings": {"a": [1, 2.5]}, "host": "Zürich"}
    with RunWriter(tmp_path / "run.mcap", values):
        pass
    found = read(tmp_path / "run.mcap").metadata
    assert json.loads(found["settings"]) == values["settings"] and found["host"] == "Zürich"


# ---------------------------------------------------------------------- crashes and resumes


def test_a_file_is_whole_before_it_is_closed(tmp_path):
    path = tmp_path / "run.mcap"
    writer = RunWriter(path, {"experiment": EXPERIMENT.name})
    for index in range(5):
        writer.generation(**generation(index))
        writer.flush()
        assert count_by_others(path) == 4 * (index + 1)
        recording = read(path)
        assert recording.problem is None and not recording.complete
        assert recording.generations[-1] == index
    assert "incomplete (the run has not ended, or was killed): it goes up to generation 4" in (
        describe(path)
    )
    writer.close()
    writer.close()
    assert read(path).complete and "incomplete" not in describe(path)


def test_a_run_that_was_stopped_says_so(tmp_path):
    path = tmp_path / "run.mcap"
    with (
        pytest.raises(KeyboardInterrupt),
        RunWriter(path, {"experiment": EXPERIMENT.name}) as writer,
    ):
        writer.generation(**generation(0))
        raise KeyboardInterrupt
    assert not read(path).complete
    assert "incomplete (the run was stopped): it goes up to generation 0" in describe(path)


def test_a_killed_process_leaves_a_readable_file(tmp_path):
    path = tmp_path / "run.mcap"
    script = (
        "import sys, time; sys.path[:0] = ['tests']\n"
        "from test_recording import *\n"
        f"writer = RunWriter({str(path)!r}, {{'experiment': EXPERIMENT.name}})\n"
        "for index in range(10**6):\n"
        "    writer.generation(**generation(index)); writer.flush()\n"
        "    print(index, flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    done = [int(process.stdout.readline()) for _ in range(40)][-1]
    process.send_signal(signal.SIGKILL)
    process.wait()
    recording = read(path)
    assert recording.generations[-1] >= done
    assert np.array_equal(recording.generations, np.arange(len(recording.generations)))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupt_waits_until_the_record_is_whole(number, tmp_path, monkeypatch):
    path, pwrite = tmp_path / "run.mcap", os.pwrite
    before = signal.signal(number, signal.default_int_handler)  # as `designrl train` does

    def interrupted(*arguments):
        signal.raise_signal(number)
        return pwrite(*arguments)

    with RunWriter(path, {"experiment": EXPERIMENT.name}) as writer:
        for index in range(4):
            writer.generation(**generation(index))
            monkeypatch.setattr(os, "pwrite", interrupted)
            with pytest.raises(KeyboardInterrupt):
                writer.flush()
            monkeypatch.setattr(os, "pwrite", pwrite)
    signal.signal(number, before)
    recording = read(path)
    assert recording.complete and recording.generations.tolist() == [0, 1, 2, 3]
    assert count_by_others(path) == 16


@pytest.mark.parametrize("kind", ["run", "rollout"])
def test_cut_anywhere_a_file_is_read_up_to_there(kind, run, rollout, tmp_path):
    source = {"run": run, "rollout": rollout}[kind]
    data, whole, path = source.read_bytes(), read(source), tmp_path / "cut.mcap"
    topic, field = ("/returns", "returns") if kind == "run" else ("/observation", "values")
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
        else:
            with pytest.raises(RecordingError, match=r"cut\.mcap holds nothing to tell of"):
                describe(path)
            nothing += 1
        found = recording.array(topic, field) if recording.topics.get(topic) else expected[:0]
        assert np.array_equal(found, expected[: len(found)])
        lengths.add(len(found))
    # This episode fits in a single chunk.
    assert nothing and len(lengths) > (3 if kind == "run" else 0)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_lies_about_its_size_takes_no_memory(compression, monkeypatch):
    bomb = bytes(2**26)
    compress = zstandard.compress if compression == "zstd" else lz4.frame.compress
    chunk = Chunk(compression, compress(bomb), 0, 0, 0, 1000)
    with pytest.raises(scan._DamageError, match="does not match"):
        scan._decompress(chunk)
    chunk.uncompressed_size = 2**40
    with pytest.raises(scan._DamageError, match="absurd size"):
        scan._decompress(chunk)


def write_others(path, topics, metadata=None, with_schema=True, **options) -> None:
    """A recording of another program with three messages per topic."""
    writer = Writer(str(path), **options)
    writer.start()
    if metadata:
        writer.add_metadata("run", metadata)
    schema = writer.register_schema("other.Thing", "jsonschema", b"{}") if with_schema else 0
    for topic in topics:
        channel = writer.register_channel(topic, "json", schema)
        for time_ in range(3):
            writer.add_message(channel, time_, b"{}", time_)
    writer.finish()


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("use_chunking", [True, False])
def test_files_of_other_writers_are_described(compression, use_chunking, tmp_path):
    path = tmp_path / "other.mcap"
    write_others(path, ["/thing"], compression=compression, use_chunking=use_chunking)
    assert "MCAP file of another program" in describe(path)
    assert read(path).topics == {"/thing": 3}
    with pytest.raises(RecordingError, match="unknown type 'other.Thing'"):
        list(read(path).messages("/thing"))


def test_topics_and_metadata_of_our_names_do_not_make_a_file_ours(tmp_path):
    path = tmp_path / "other.mcap"
    write_others(path, ["/summary", "/tf", "/evaluation", "/reward"], {"robot": "other"})
    recording = read(path)
    assert recording.kind == "unknown" and recording.metadata == {} and recording.complete
    assert len(recording.generations) == 0
    assert "not a recording of designrl but an MCAP file of another program" in describe(path)
    assert "incomplete" not in describe(path)


def test_messages_without_a_schema_are_counted(tmp_path):
    path = tmp_path / "other.mcap"
    write_others(path, ["/thing"], with_schema=False)
    assert read(path).topics == {"/thing": 3} and "/thing: 3" in describe(path)
    with pytest.raises(RecordingError, match="no field 'x'"):
        read(path).array("/thing", "x")


@pytest.mark.parametrize("resume", [0, 1, 5, 12, 20])
def test_a_resumed_run_has_every_generation_once(resume, run, tmp_path):
    path = tmp_path / "run.mcap"
    path.write_bytes(run.read_bytes())
    stop = max(resume, 12) + 3
    write_run(path, range(resume, stop), resume_generation=resume)
    recording = read(path)
    kept = min(resume, 12)
    expected = [*range(kept), *range(resume, stop)]
    assert recording.generations.tolist() == expected
    found = recording.array("/returns", "returns")
    assert np.array_equal(found, [generation(i)["returns"] for i in expected])
    evaluated = recording.array("/evaluation", "generation").tolist()
    assert evaluated == [i for i in expected if i % 5 == 4]
    names = [name for name, _ in recording.metadata_records]
    assert names == ["run", "resumed", "end"] and recording.metadata["seed"] == "7"
    times = recording.array("/summary", "log_time")
    assert (np.diff(times) >= 0).all()


@pytest.mark.parametrize("held", [None, 0, 4])
def test_a_resume_says_which_generations_are_missing(held, tmp_path, capsys):
    path = tmp_path / "run.mcap"
    if held is not None:
        write_run(path, range(held))
    write_run(path, range(6, 9), resume_generation=6)
    recording, first = read(path), held or 0
    gap = f"{6 - first} of the generations {first} to 5 are missing"
    assert capsys.readouterr().err == f"{path}: {gap} (the file was cut or removed); going on\n"
    assert recording.kind == "run" and recording.metadata["seed"] == "7" and recording.complete
    assert recording.generations.tolist() == [*range(first), 6, 7, 8]
    assert dict(recording.metadata_records)["resumed"] == {"generation": "6", "missing": gap}
    assert f"{6 - first} generations are missing" in describe(path)


def test_nothing_is_said_where_nothing_is_missing(run, tmp_path, capsys):
    path = tmp_path / "run.mcap"
    path.write_bytes(run.read_bytes())
    write_run(path, range(7, 9), resume_generation=7)
    thin(path, tmp_path / "thin.mcap", every=4)
    assert capsys.readouterr().err == ""
    assert "missing" not in describe(path) and "missing" not in describe(tmp_path / "thin.mcap")


def test_a_run_resumes_from_a_file_that_was_cut(run, tmp_path):
    data, path = run.read_bytes(), tmp_path / "run.mcap"
    for cut in np.random.default_rng(1).integers(8, len(data), 10):
        path.write_bytes(data[:cut])
        held = len(read(path).generations)
        resume = min(held, 6)
        write_run(path, range(resume, 8), resume_generation=resume)
        recording = read(path)
        assert recording.generations.tolist() == list(range(8)) and recording.complete
        assert recording.metadata == {"experiment": EXPERIMENT.name, "seed": "7"}


def test_a_resume_that_fails_leaves_the_old_file(run, tmp_path, monkeypatch):
    path = tmp_path / "run.mcap"
    path.write_bytes(run.read_bytes())
    monkeypatch.setattr(os, "pwrite", _full_disk(after=20_000))
    with pytest.raises(RecordingError, match="No space left on device.*recorded before is intact"):
        RunWriter(path, {"experiment": EXPERIMENT.name}, resume_generation=9)
    assert path.read_bytes() == run.read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def _full_disk(after: int):
    """os.pwrite on a disk that has room for so many bytes of the file."""
    pwrite = os.pwrite

    def write(descriptor, data, offset):
        room = after - offset
        if room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return pwrite(descriptor, bytes(data)[:room], offset)

    return write


def test_a_full_disk_is_one_sentence_and_costs_no_generation(tmp_path, monkeypatch):
    path = tmp_path / "run.mcap"
    monkeypatch.setattr(os, "pwrite", _full_disk(after=150_000))
    done = -1
    with (
        pytest.raises(RecordingError, match=r"cannot be written \(No space left on device\)"),
        RunWriter(path, {"experiment": EXPERIMENT.name}) as writer,
    ):
        for index in range(100):
            writer.generation(**generation(index))
            writer.flush()
            done = index
    assert done >= 3
    recording = read(path)
    assert recording.problem is None and recording.generations[-1] == done
    assert count_by_others(path) == 4 * (done + 1)


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="file/run.mcap cannot be written"):
        RunWriter(tmp_path / "file" / "run.mcap", {})


# ----------------------------------------------------------------------------- thinning


def test_thinning_drops_generations_and_rounds_nothing(run, tmp_path):
    thin(run, tmp_path / "thin.mcap", every=5)
    whole, thinned = read(run), read(tmp_path / "thin.mcap")
    kept = [0, 5, 10, 11]
    assert thinned.array("/distribution", "generation").tolist() == kept
    for topic, field, rows in (
        ("/distribution", "mu", kept),
        ("/distribution", "sigma", kept),
        ("/returns", "returns", kept),
        ("/summary", "mean", slice(None)),
        ("/evaluation", "scores", slice(None)),
    ):
        assert np.array_equal(thinned.array(topic, field), whole.array(topic, field)[rows])
    record = dict(thinned.metadata_records)["thinned"]
    found = [record[key] for key in ("every", "kept_generations", "of_generations")]
    assert found == ["5", "4", "12"]
    assert thinned.complete and "thinned" in describe(tmp_path / "thin.mcap")
    assert thinned.metadata == whole.metadata


def test_designs_are_thinned_a_tenth_as_much(run, tmp_path):
    thin(run, tmp_path / "thin.mcap", every=60)
    thinned = read(tmp_path / "thin.mcap")
    assert thinned.array("/distribution", "generation").tolist() == [0, 11]
    assert thinned.array("/design", "generation").tolist() == [0, 6, 11]
    assert len(thinned.array("/summary", "generation")) == 12
    # Of a run that went on from a thinned one, the next that is there stands for a missing one.
    thin(tmp_path / "thin.mcap", tmp_path / "again.mcap", every=20)
    again = read(tmp_path / "again.mcap")
    assert again.array("/design", "generation").tolist() == [0, 6, 11]


def test_only_runs_are_thinned(rollout, tmp_path):
    with pytest.raises(RecordingError, match="holds no generations"):
        thin(rollout, tmp_path / "thin.mcap", every=2)
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------------------- rollouts


@pytest.mark.parametrize("name", ["biped", "biped-hardcore-morphology", "ant-morphology"])
def test_a_rollout_is_the_episode_that_an_evaluation_runs(name, tmp_path):
    agent, path = random_agent(name), tmp_path / "rollout.mcap"
    score = record_rollout(agent, path, seed=5, metadata={"note": "é"})
    with Simulator(name, backend="reference") as simulator:
        expected = simulator.rollout(agent.parameters[None], np.array([[5]]))
    assert score == expected.returns[0, 0]

    recording = read(path)
    assert recording.kind == "rollout" and recording.complete
    assert recording.metadata["experiment"] == name and recording.metadata["note"] == "é"
    assert float(recording.metadata["score"]) == score
    assert json.loads(recording.metadata["agent"])["seed"] == 1
    assert recording.array("/reward", "total")[-1] == score
    assert np.allclose(
        recording.array("/reward", "terms").sum(axis=1), recording.array("/reward", "reward")
    )

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


def test_a_rollout_that_fails_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "pwrite", _full_disk(after=1000))
    with pytest.raises(RecordingError, match="No space left") as failure:
        record_rollout(random_agent("biped"), tmp_path / "rollout.mcap", seed=0)
    assert list(tmp_path.iterdir()) == [] and "intact" not in str(failure.value)


def test_a_rollout_that_was_cut_still_says_where_it_came_from(tmp_path, rollout):
    path, data = tmp_path / "cut.mcap", rollout.read_bytes()
    path.write_bytes(data[: data.rindex(b"\x05\0\0\0score")])
    recording, whole = read(path), read(rollout).metadata
    assert recording.kind == "rollout" and recording.problem
    assert {**recording.metadata, "score": whole["score"], "steps": whole["steps"]} == whole
    assert recording.metadata["seed"] == "3" and "agent" in recording.metadata
    assert "score" not in recording.metadata


def test_a_negative_seed_is_refused(tmp_path):
    with pytest.raises(InputError, match="the seed is -1; choose one from 0 up"):
        record_rollout(random_agent("biped"), tmp_path / "rollout.mcap", seed=-1)
    assert list(tmp_path.iterdir()) == []


def test_two_processes_do_not_write_into_one_file(tmp_path):
    script = (
        "import sys; from designrl.recording.mcap_file import McapFile\n"
        "file = McapFile(sys.argv[1]); file.metadata('from', {'who': 'other'})\n"
        "print(flush=True); sys.stdin.read(); file.publish(); file.close()\n"
    )
    path = tmp_path / "x.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", script, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        other.stdout.readline()
        file = McapFile(path)
        file.metadata("from", {"who": "this"})
        file.publish()
        file.close()
        assert read(path).metadata_records == [("from", {"who": "this"})]
    assert read(path).metadata_records == [("from", {"who": "other"})]
    assert [p.name for p in tmp_path.iterdir()] == ["x.mcap"]
