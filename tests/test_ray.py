"""On a Ray cluster: the same bytes, also when a node is lost."""

import subprocess
import sys
import threading
import time
from contextlib import closing

import numpy as np
import pytest

import designrl.workers
from designrl.errors import InputError
from designrl.experiments import get_experiment
from designrl.files import file_hash
from designrl.recording import read
from designrl.settings import TrainSettings
from designrl.simulation import Simulator
from designrl.train import TrainingRun
from designrl.workers import RayWorkers, TaskError

WHY = "Ray is not installed (pip install -c requirements-extras.lock ray)"
ray = pytest.importorskip("ray", reason=WHY)

SETTINGS = TrainSettings.of(
    "biped-morphology",
    generations=6,
    population=6,
    rollouts=2,
    evaluate_every=3,
    evaluation_episodes=4,
)
CANDIDATES = np.arange(4.0)[:, None]
TASKS = [(slice(i, i + 1),) for i in range(4)]


@pytest.fixture
def cluster():
    """Two nodes on this machine with a core each; Ray takes its address from "auto"."""
    from ray.cluster_utils import Cluster

    found = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    found.add_node(num_cpus=1)
    found.wait_for_nodes()
    yield found
    ray.shutdown()
    found.shutdown()


def test_a_node_is_lost_and_the_bytes_are_the_same(cluster, tmp_path, monkeypatch):
    TrainingRun(SETTINGS, tmp_path / "here", backend="reference").run()
    lost, rollout = [], Simulator.rollout

    def lose_a_node(self, *arguments, **kwargs):
        if self._pool and not lost:
            lost.extend(sorted(cluster.worker_nodes, key=str)[:1])
        elif lost and len(lost) == 1:  # in the second generation, while its episodes run
            threading.Timer(0.1, cluster.remove_node, lost[:1], {"allow_graceful": False}).start()
            lost.append("removed")
        return rollout(self, *arguments, **kwargs)

    monkeypatch.setattr(Simulator, "rollout", lose_a_node)
    run = TrainingRun(SETTINGS, tmp_path / "ray", backend="reference", ray=cluster.address)
    run.run()
    here, there = (file_hash(tmp_path / name / "best.safetensors") for name in ("here", "ray"))
    assert here == there
    assert read(tmp_path / "ray/generations.mcap").generations.tolist() == list(range(6))
    assert len(lost) == 2


def test_the_engine_gives_the_same_bits_on_ray(cluster):
    experiment = get_experiment("biped-hardcore-morphology")
    candidates = 0.1 * np.random.default_rng(0).standard_normal((4, experiment.num_parameters))
    seeds = np.arange(12).reshape(4, 3)
    here = Simulator(experiment, "engine").rollout(candidates, seeds)
    with Simulator(experiment, "engine", ray=cluster.address) as simulator:
        there = simulator.rollout(candidates, seeds)
    np.testing.assert_array_equal(there.returns, here.returns)
    np.testing.assert_array_equal(there.steps, here.steps)


def test_waiting_for_a_core_is_mentioned_once(cluster, capsys, monkeypatch):
    monkeypatch.setattr(designrl.workers, "PATIENCE_SECONDS", 1.0)

    @ray.remote(num_cpus=1)
    class Hog:
        def ready(self):
            return True

    with closing(RayWorkers(cluster.address)) as workers:
        hogs = [Hog.remote() for _ in range(2)]  # one for each node
        ray.get([hog.ready.remote() for hog in hogs])
        threading.Timer(8.0, ray.kill, hogs[:1]).start()
        results = dict(workers.run(lambda rows: rows[0, 0], CANDIDATES, TASKS, 60))
    assert results == dict(enumerate(range(4)))
    assert capsys.readouterr().err.count("no free core") == 1


@pytest.mark.parametrize("what", ["dies", "hangs", "raises"])
def test_a_task_that_fails_each_time_is_named(what, cluster, tmp_path):
    def fail(candidates):  # within this function, or Ray would look for this module elsewhere
        import os

        if candidates[0, 0] == 2:
            with open(tmp_path / "tries", "a") as file:
                file.write(".")
            if what == "dies":
                os._exit(1)
            if what == "hangs":
                time.sleep(1000)
            raise RuntimeError("something\nhappened")
        return candidates[0, 0]

    with closing(RayWorkers(cluster.address)) as workers:
        with pytest.raises(TaskError, match="something|died") as caught:
            list(workers.run(fail, CANDIDATES, TASKS, 3))
        assert dict(workers.run(np.sum, CANDIDATES, TASKS, 60)) == dict(enumerate(range(4)))
    assert caught.value.index == 2
    assert (tmp_path / "tries").read_text() == "..."


def test_wrong_input_and_another_version_end_the_run(cluster, monkeypatch):
    def refuse(candidates):
        raise InputError("not this")

    with closing(RayWorkers(cluster.address)) as workers:
        with pytest.raises(InputError, match="^not this$"):
            list(workers.run(refuse, CANDIDATES, TASKS, 60))
        monkeypatch.setattr(designrl.workers, "sources_hash", lambda: "other")
        with pytest.raises(InputError, match="another version of designrl .* here other"):
            list(workers.run(np.sum, CANDIDATES, TASKS, 60))


def test_a_local_cluster_listens_on_this_machine_alone():
    code = (
        "import numpy, psutil\n"
        "from designrl.workers import RayWorkers\n"
        "before = {c.laddr for c in psutil.net_connections('inet') if c.status == 'LISTEN'}\n"
        "workers = RayWorkers('local')\n"
        "tasks = [(slice(2),)]\n"
        "assert list(workers.run(sum, numpy.array([1, 2]), tasks, 60)) == [(0, 3)]\n"
        "for c in psutil.net_connections('inet'):\n"
        "    if c.status == 'LISTEN' and c.laddr not in before: print(c.laddr.ip)\n"
        "workers.close()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=1800
    )
    addresses = set(done.stdout.split())
    assert addresses and addresses <= {"127.0.0.1", "::ffff:127.0.0.1", "::1"}, done.stderr


def test_an_address_without_a_cluster_is_refused():
    with pytest.raises(InputError, match="no Ray cluster at"):
        Simulator("biped", ray="127.0.0.1:1")


def test_a_process_that_is_in_a_cluster_already_uses_that_and_stays_in_it():
    ray.init("local", num_cpus=1, include_dashboard=False, log_to_driver=False)
    try:
        here = ray.get_runtime_context().gcs_address
        for address in ("local", "auto", here):
            with closing(RayWorkers(address)) as workers:
                assert dict(workers.run(np.sum, CANDIDATES, TASKS, 60.0)) == dict(
                    enumerate(range(4))
                )
            assert ray.is_initialized()
        with pytest.raises(InputError, match=f"in the Ray cluster at {here} already"):
            RayWorkers("10.0.0.7:6379")
    finally:
        ray.shutdown()
