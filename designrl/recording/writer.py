"""Writers of the two kinds of recordings: a training run, and one rollout."""

import json
import math
import time
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from mcap_protobuf.schema import build_file_descriptor_set

from designrl.experiments import get_experiment
from designrl.recording import schema_pb2 as schema
from designrl.recording.bodies import GROUND_REFRESH, make_body, relative
from designrl.recording.mcap_file import McapFile, RecordingError, messages, scan, uninterrupted

RUN, ROLLOUT, END, RESUMED, THINNED = "run", "rollout", "end", "resumed", "thinned"
HEAVY_TOPICS = ("/distribution", "/returns")  # all but a hundredth of a run's bytes


def protobuf_schema(kind, names=(), unit: str = "") -> tuple[str, str, bytes, dict[str, str]]:
    """Name, encoding and definition of a message, and what the channel says of its arrays."""
    definition = build_file_descriptor_set(kind).SerializeToString()
    about = {"names": json.dumps(list(names)), "unit": unit}
    about = {key: value for key, value in about.items() if value not in ("", "[]")}
    return kind.DESCRIPTOR.full_name, "protobuf", definition, about


def as_text(values: dict) -> dict[str, str]:
    """Metadata as MCAP wants it: everything that is not text becomes JSON."""
    return {
        str(key): value if isinstance(value, str) else json.dumps(value)
        for key, value in values.items()
    }


class RunWriter:
    """Records a training run in `generations.mcap`; a context manager.

    The file is whole at every moment: a process that is killed loses what it recorded in the last
    second or, where writing is slow, in the last hundred times as long as a write takes.

    Args:
        path: the file; replaced if it exists, unless `resume_generation` is given.
        metadata: what to say of the run; "experiment" names it and the body's dimensions.
        resume_generation: keep what an existing file holds of the generations before this one,
            drop the rest, and go on.

    Raises (every method):
        RecordingError: the file cannot be written, or the one to go on with is no recording.
    """

    def __init__(
        self,
        path: str | Path,
        metadata: dict[str, str],
        resume_generation: int | None = None,
    ):
        name = metadata.get("experiment")
        experiment = get_experiment(name) if name else None
        self._design = experiment.design if experiment else None
        self._log_time = 0
        old = Path(path)
        resumed = resume_generation is not None and old.exists()
        self._file = McapFile(path)
        try:
            if resumed:
                _copy(self._file, old, lambda topic, index: index < resume_generation)
                self._log_time = self._file.last_log_time
                values = {**as_text(metadata), "generation": str(resume_generation)}
                self._file.metadata(RESUMED, values)
            else:
                self._file.metadata(RUN, as_text(metadata))
            self._file.publish()
        except BaseException:
            self._file.abandon()
            raise

    def _write(self, topic: str, message, names=(), unit: str = "") -> None:
        # A wall clock may be set back; readers want times that never decrease.
        self._log_time = max(time.time_ns(), self._log_time)
        channel = self._file.channel(topic, lambda: protobuf_schema(type(message), names, unit))
        data = message.SerializeToString()
        self._file.message(channel, self._log_time, message.generation, data)

    @uninterrupted()
    def generation(
        self,
        index: int,
        mu: np.ndarray,
        sigma: np.ndarray,
        returns: np.ndarray,
        steps: np.ndarray,
        seeds: np.ndarray,
        seconds: float,
        total_steps: int,
    ) -> None:
        """Record a generation.

        Args:
            index: of the generation, from 0.
            mu, sigma: (P,) the distribution that it was sampled from; stored as float32.
            returns: (N, R) float64, return of each episode of each candidate.
            steps: (N, R) their lengths.
            seeds: (N, R) their seeds.
            seconds: s of wall time that the run has taken so far.
            total_steps: environment steps of the run so far.
        """
        mu, sigma = np.asarray(mu, dtype=np.float32), np.asarray(sigma, dtype=np.float32)
        fitness = np.mean(returns, axis=1)
        self._write(
            "/summary",
            schema.Summary(
                generation=index,
                mean=fitness.mean(),
                sd=fitness.std(),
                best=fitness.max(),
                worst=fitness.min(),
                sigma_mean=sigma.mean(dtype=np.float64),
                sigma_min=sigma.min(),
                sigma_max=sigma.max(),
                steps=int(np.sum(steps)),
                total_steps=total_steps,
                seconds=seconds,
            ),
        )
        if self._design is not None:
            size = self._design.size
            m, s = mu[-size:].astype(np.float64), sigma[-size:].astype(np.float64)
            mean, one, other = (
                self._design.dimensions(self._design.scales(p)) for p in (m, m - s, m + s)
            )
            self._write(
                "/design",
                schema.Design(
                    generation=index,
                    mu=mu[-size:].tolist(),
                    sigma=sigma[-size:].tolist(),
                    dimensions=mean.tolist(),
                    lower=one.tolist(),
                    upper=other.tolist(),
                ),
                self._design.names,
                self._design.unit,
            )
        self._write(
            "/distribution",
            schema.Distribution(generation=index, mu=mu.tolist(), sigma=sigma.tolist()),
        )
        self._write(
            "/returns",
            schema.Returns(
                generation=index,
                rollouts=np.shape(returns)[1],
                returns=np.ravel(returns).tolist(),
                steps=np.ravel(steps).tolist(),
                seeds=np.ravel(seeds).tolist(),
            ),
        )
        self._file.seal_if_due()

    @uninterrupted()
    def evaluation(
        self, index: int, scores: np.ndarray, steps: np.ndarray, seeds: np.ndarray, kept: bool
    ) -> None:
        """Record an evaluation of the best candidate of generation `index`.

        Args:
            scores, steps, seeds: (E,) return, length and seed of each episode.
            kept: it is the best so far.
        """
        self._write(
            "/evaluation",
            schema.Evaluation(
                generation=index,
                kept=bool(kept),
                mean=np.mean(scores),
                sd=np.std(scores),
                scores=np.ravel(scores).tolist(),
                steps=np.ravel(steps).tolist(),
                seeds=np.ravel(seeds).tolist(),
            ),
        )
        self._file.seal_if_due()

    @uninterrupted()
    def flush(self) -> None:
        """Put everything so far into the file."""
        self._file.seal()

    @uninterrupted()
    def close(self, finished: bool = True) -> None:
        """Put everything into the file and end it; a second call does nothing."""
        if self._file.is_open:
            self._file.metadata(END, {"finished": str(finished).lower()})
            self._file.close()

    def __enter__(self) -> "RunWriter":
        return self

    def __exit__(self, kind, error, traceback) -> None:
        if kind is not None and issubclass(kind, RecordingError):
            self._file.abandon()  # it has said what is wrong, and the file is as good as it gets
        else:
            self.close(finished=kind is None)


def _copy(target: McapFile, source: Path, keep) -> None:
    """Copy metadata and the messages for which keep(topic, generation) holds."""
    found = scan(source)
    for name, values in found.metadata:
        if name != END:
            target.metadata(name, values)
    ids = {}
    for channel in found.channels.values():
        old = found.schema(channel)
        ids[channel.id] = target.channel(
            channel.topic,
            lambda old=old, about=channel.metadata: (old.name, old.encoding, old.data, about),
        )
    for message in messages(found, set(ids)):
        if keep(found.channels[message.channel_id].topic, message.sequence):
            target.message(
                ids[message.channel_id], message.log_time, message.sequence, message.data
            )
            target.seal_if_due()


def thin(source: str | Path, target: str | Path, every: int) -> None:
    """Copy a run's recording with the distributions and returns of only some generations.

    Kept are those of every `every`-th generation and of the last; summaries, designs and
    evaluations of all generations. Nothing is rounded. The metadata record "thinned" says what was
    done.

    Raises:
        RecordingError: a file cannot be read or written, or is not of a run.
    """
    found = scan(source)
    topics = {channel.topic: channel.id for channel in found.channels.values()}
    if "/summary" not in topics:
        raise RecordingError(f"{source} is not the recording of a run; name a generations.mcap")
    chosen = {m.sequence for m in messages(found, {topics["/summary"]})}
    kept = {g for g in chosen if g % every == 0} | {min(chosen), max(chosen)}
    file = McapFile(target)
    try:
        _copy(file, Path(source), lambda topic, g: topic not in HEAVY_TOPICS or g in kept)
        values = {
            "every": every,
            "topics": HEAVY_TOPICS,
            "kept_generations": len(kept),
            "of_generations": len(chosen),
            "note": "these topics have the first, the last and every Nth generation; the other "
            "topics are complete, and nothing is rounded",
        }
        file.metadata(THINNED, as_text(values))
        for name, end in found.metadata:
            if name == END:
                file.metadata(END, end)
        file.publish()
    finally:
        file.abandon()


# ----------------------------------------------------------------------------------- a rollout


def _cdr_string(text: str) -> bytes:
    """A std_msgs/msg/String in CDR: little-endian header, length with the closing zero, text."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


class RolloutWriter:
    """Records one episode, step by step; a context manager.

    The file appears under its name when the episode is over and recorded; an episode is short.

    Args:
        path: the file.
        env: one of this package's environments, already reset.
        metadata: what to say of the rollout.

    Raises (every method):
        RecordingError: the file cannot be written.
    """

    def __init__(self, path: str | Path, env, metadata: dict):
        self._body = make_body(env)
        parts = list(self._body.parents)
        self._parent_indices = [parts.index(p) for p in list(self._body.parents.values())[1:]]
        self._metadata = dict(metadata)
        self._step, self._total, self._shown_at = 0, 0.0, None
        self._file = McapFile(path)
        description = self._body.urdf(_caption(metadata))
        string = ("std_msgs/msg/String", "ros2msg", b"string data\n", {})
        channel = self._file.channel("/robot_description", lambda: string)
        self._file.message(channel, 0, 0, _cdr_string(description))
        terrain = self._body.terrain()
        if terrain is not None:
            profile, obstacles = terrain
            message = schema.Terrain(x=profile[:, 0].tolist(), z=profile[:, 1].tolist())
            for x0, x1, z0, z1 in obstacles.tolist():
                message.obstacles.add(x_min=x0, x_max=x1, z_min=z0, z_max=z1)
            self._write("/terrain", message, 0)
        self._write_poses()

    def _write(self, topic: str, message, time_ns: int, names=()) -> None:
        channel = self._file.channel(topic, lambda: protobuf_schema(type(message), names))
        self._file.message(channel, time_ns, self._step, message.SerializeToString())

    def _now(self) -> int:
        return round(self._step * self._body.dt * 1e9)

    def _write_poses(self) -> None:
        now = self._now()
        positions, rotations = self._body.poses()
        place = positions[0].copy()
        parents = self._parent_indices
        hanging = (positions[parents], rotations[parents]), (positions[1:], rotations[1:])
        positions[1:], rotations[1:] = relative(*hanging)
        message = FrameTransforms()
        for (part, parent), p, q in zip(
            self._body.parents.items(), positions.tolist(), rotations.tolist(), strict=True
        ):
            transform = message.transforms.add(parent_frame_id=parent, child_frame_id=part)
            transform.timestamp.FromNanoseconds(now)
            t, r = transform.translation, transform.rotation
            t.x, t.y, t.z = p
            r.x, r.y, r.z, r.w = q
        self._write("/tf", message, now)
        if self._shown_at is None or math.dist(place, self._shown_at) > GROUND_REFRESH:
            self._shown_at = place
            self._write("/ground", _point_cloud(*self._body.ground_near(place), now), now)

    def step(self, observation, action, reward: float, info: dict) -> None:
        """Record a step, after the environment took it.

        Args:
            observation: (O,) what the agent saw before it.
            action: (A,) what it did.
            reward: what it got.
            info: of the environment; "reward_terms" holds the parts of the reward.
        """
        body, step = self._body, self._step
        before = self._now()
        values = np.asarray(observation, dtype=np.float32).tolist()
        self._write(
            "/observation",
            schema.Observation(step=step, values=values),
            before,
            names=body.observation_names,
        )
        values = np.asarray(action, dtype=np.float32).tolist()
        self._write(
            "/action", schema.Action(step=step, values=values), before, names=body.joint_names
        )
        self._step += 1
        after = self._now()
        self._total += float(reward)
        terms = info["reward_terms"]
        message = schema.Reward(
            step=step, reward=reward, total=self._total, terms=list(terms.values())
        )
        self._write("/reward", message, after, names=list(terms))
        angles, speeds, torques = body.joints()
        message = schema.Joints(step=step, angles=angles, speeds=speeds, torques=torques)
        self._write("/joints", message, after, names=body.joint_names)
        message = schema.Contacts(step=step, touching=body.contacts())
        self._write("/contacts", message, after, names=body.contact_names)
        rays = body.lidar()
        if rays is not None:
            (x, z), ends = rays[0, 0].tolist(), rays[:, 1]
            message = schema.Lidar(
                step=step,
                origin_x=x,
                origin_z=z,
                end_x=ends[:, 0].tolist(),
                end_z=ends[:, 1].tolist(),
            )
            self._write("/lidar", message, after)
        self._write_poses()

    @property
    def score(self) -> float:
        """Sum of the rewards so far."""
        return self._total

    def close(self) -> None:
        """Put the file in place."""
        values = {**self._metadata, "score": self._total, "steps": self._step}
        self._file.metadata(ROLLOUT, as_text(values))
        self._file.metadata(END, {"finished": "true"})
        self._file.publish()
        self._file.abandon()

    def __enter__(self) -> "RolloutWriter":
        return self

    def __exit__(self, kind, error, traceback) -> None:
        if kind is None:
            self.close()
        self._file.abandon()


def _caption(metadata: dict) -> str:
    """What stands above the URDF; viewers show it as text beside the picture."""
    lines = [f"{key}: {metadata[key]}" for key in ("experiment", "seed") if key in metadata]
    if "body" in metadata:
        lines.append(f"body, in {metadata['unit']}:")
        lines += [f"  {name}: {size:.4g}" for name, size in metadata["body"].items()]
    return "\n".join(["designrl rollout", *lines])


def _point_cloud(points: np.ndarray, colors: np.ndarray, now: int) -> PointCloud:
    """Points (n, 3) in m with colors (n, 3) in 0..255, in the frame `world`."""
    records = np.zeros(
        len(points), dtype=[("position", "<f4", 3), ("color", "u1", 3), ("alpha", "u1")]
    )
    records["position"], records["color"], records["alpha"] = points, colors, 255
    cloud = PointCloud(frame_id="world", point_stride=records.itemsize, data=records.tobytes())
    cloud.timestamp.FromNanoseconds(now)
    cloud.pose.orientation.w = 1.0
    for i, name in enumerate("xyz"):
        cloud.fields.add(name=name, offset=4 * i, type=PackedElementField.FLOAT32)
    for i, name in enumerate(("red", "green", "blue", "alpha")):
        cloud.fields.add(name=name, offset=12 + i, type=PackedElementField.UINT8)
    return cloud


def record_rollout(agent, path: str | Path, seed: int, metadata: dict | None = None) -> float:
    """Roll an agent out once, in its own body, and record that.

    Args:
        agent: a `designrl.policy.Agent`.
        path: the file to write.
        seed: of the environment and of the policy's noise.
        metadata: what else to say of it.

    Returns: the score, the same as an evaluation gives for that seed.

    Raises:
        RecordingError: the file cannot be written.
    """
    import gymnasium

    import designrl  # noqa: F401 (registers the environments)

    env = gymnasium.make(agent.experiment.env_id, design=agent.body, disable_env_checker=True)
    dimensions = agent.experiment.body.dimensions(agent.body)
    about = {
        "experiment": agent.experiment.name,
        "seed": seed,
        "unit": agent.experiment.body.unit,
        "body": dict(zip(agent.experiment.body.names, dimensions.tolist(), strict=True)),
        "agent": agent.metadata,
        **(metadata or {}),
    }
    agent.reset(seed)
    observation, _ = env.reset(seed=seed)
    with RolloutWriter(path, env, about) as writer:
        done, t = False, 0
        while not done:
            action = agent.act(observation, t)
            seen = observation
            observation, reward, terminated, truncated, info = env.step(action)
            writer.step(seen, action, reward, info)
            done, t = terminated or truncated, t + 1
    env.close()
    return writer.score
