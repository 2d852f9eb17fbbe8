"""Recording one episode, in a way that any viewer of MCAP files draws."""

import math
from pathlib import Path

import gymnasium
import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from designrl.bodies import relative
from designrl.design import in_words
from designrl.numeric import whole_number
from designrl.recording import schema_pb2 as schema
from designrl.recording.mcap_file import END, ROLLOUT, McapFile
from designrl.recording.points import point_cloud

GROUND_REFRESH = 1.0  # m that a body moves before the ground near it is recorded again


def _cdr_string(text: str) -> bytes:
    """A std_msgs/msg/String in CDR: little-endian header, length with the closing zero, text."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


class RolloutWriter:
    """Records one episode, step by step; a context manager.

    The file appears under its name when the episode is over and recorded; an episode is short.

    Args:
        path: the file.
        env: an environment with a `designrl.bodies.Body` as its `body`, already reset.
        metadata: what to say of the rollout; "experiment", the name of one with this body, is what
            `designrl replay` knows the body by.

    Attributes:
        score: sum of the rewards so far.

    Raises (every method):
        RecordingError: the file cannot be written.
    """

    def __init__(self, path: str | Path, env, metadata: dict):
        self._env, self._body = env.unwrapped, env.unwrapped.body
        parts = list(self._body.tree)
        self._parent_indices = [parts.index(p) for p in list(self._body.tree.values())[1:]]
        self._step, self._shown_at, self.score = 0, None, 0.0
        self._file = McapFile(path)
        self._file.metadata(ROLLOUT, metadata)  # first, so that a file that was cut has it
        robot = "/robot_description"
        self._file.add_channel(robot, "std_msgs/msg/String", "ros2msg", b"string data\n", {})
        description = self._body.urdf(self._env.design, _caption(metadata))
        self._file.message(robot, 0, 0, _cdr_string(description))
        if (terrain := self._body.terrain(self._env)) is not None:
            profile, obstacles = terrain
            message = schema.Terrain(x=profile[:, 0].tolist(), z=profile[:, 1].tolist())
            for x0, x1, z0, z1 in obstacles.tolist():
                message.obstacles.add(x_min=x0, x_max=x1, z_min=z0, z_max=z1)
            self._file.write(message, 0, 0)
        self._write_poses()

    def _now(self) -> int:
        return round(self._step * self._body.time_step * 1e9)

    def _write_poses(self) -> None:
        now = self._now()
        positions, rotations = self._body.poses(self._env)
        place, parents = positions[0].copy(), self._parent_indices
        hanging = (positions[parents], rotations[parents]), (positions[1:], rotations[1:])
        positions[1:], rotations[1:] = relative(*hanging)
        message = FrameTransforms()
        for (part, parent), p, q in zip(
            self._body.tree.items(), positions.tolist(), rotations.tolist(), strict=True
        ):
            transform = message.transforms.add(parent_frame_id=parent, child_frame_id=part)
            transform.timestamp.FromNanoseconds(now)
            t, r = transform.translation, transform.rotation
            t.x, t.y, t.z = p
            r.x, r.y, r.z, r.w = q
        self._file.write(message, now, self._step, topic="/tf")
        if self._shown_at is None or math.dist(place, self._shown_at) > GROUND_REFRESH:
            self._shown_at = place
            cloud = point_cloud(*self._body.ground_near(self._env, place), now)
            self._file.write(cloud, now, self._step, topic="/ground")

    def step(self, observation, action, reward: float, info: dict) -> None:
        """Record a step, after the environment took it.

        Args:
            observation: (O,) what the agent saw before it.
            action: (A,) what it did.
            reward: what it got.
            info: of the environment; "reward_terms" holds the parts of the reward, if any.
        """
        body, env, step, before = self._body, self._env, self._step, self._now()

        def write(kind, log_time, names=(), **fields):
            self._file.write(kind(step=step, **fields), log_time, step, names)

        seen, done = np.float32(observation).tolist(), np.float32(action).tolist()
        write(schema.Observation, before, body.observations, values=seen)
        write(schema.Action, before, body.joints, values=done)
        self._step += 1
        after = self._now()
        self.score += float(reward)
        terms = info.get("reward_terms", {"reward": reward})
        rewards = {"reward": reward, "total": self.score, "terms": terms.values()}
        write(schema.Reward, after, list(terms), **rewards)
        if (states := body.joint_states(env)) is not None:
            angles, speeds, torques = states
            write(schema.Joints, after, body.joints, angles=angles, speeds=speeds, torques=torques)
        if (touching := body.contacts(env)) is not None:
            write(schema.Contacts, after, body.contact_names, touching=touching)
        if (rays := body.lidar(env)) is not None:
            (x, z), (end_x, end_z) = rays[0, 0].tolist(), rays[:, 1].T.tolist()
            write(schema.Lidar, after, origin_x=x, origin_z=z, end_x=end_x, end_z=end_z)
        self._write_poses()

    def __enter__(self) -> "RolloutWriter":
        return self

    def __exit__(self, kind, error, traceback) -> None:
        """Put the file in place, unless the episode has failed."""
        if kind is None:
            self._file.metadata(ROLLOUT, {"score": self.score, "steps": self._step})
            self._file.metadata(END, {"finished": "true"})
            self._file.publish()
        self._file.close()


def _caption(metadata: dict) -> str:
    """What stands above the URDF; viewers show it as text beside the picture."""
    lines = [f"{key}: {metadata[key]}" for key in ("experiment", "seed") if key in metadata]
    if metadata.get("changed"):
        lines.append(f"not the agent's own body: {in_words(metadata['changed'])}")
    if "body" in metadata:
        lines.append(f"body, in {metadata['unit']}:")
        lines += [f"  {name}: {size:.4g}" for name, size in metadata["body"].items()]
    return "\n".join(["designrl rollout", *lines])


def record_rollout(
    agent, path: str | Path, seed: int, steps: int | None = None, design=None
) -> float:
    """Roll an agent out once and record that.

    Args:
        agent: a `designrl.policy.Agent`.
        path: the file to write.
        seed: of the environment and of the policy's noise; `designrl.evaluation.episode_seeds`
            has those of an evaluation.
        steps: how many to record at most; None: the whole episode.
        design: the body to walk with, as `Agent.body_with` takes it; None: its own.

    Returns: the score of what is recorded, without any training-time change of the reward.

    Raises:
        InputError: the seed is no whole number from 0 on, or no design of the body.
        RecordingError: the file cannot be written.
    """
    seed = whole_number("the seed", seed, 0)
    space, scales = agent.experiment.body.design, agent.body_with(design)
    env_id = agent.experiment.env_id
    env = gymnasium.make(env_id, disable_env_checker=True, **agent.env_kwargs)
    about = {
        "experiment": agent.experiment.name,
        "seed": seed,
        "unit": space.unit,
        "body": dict(zip(space.names, space.dimensions(scales).tolist(), strict=True)),
        "agent": agent.metadata,
    }
    if changes := space.changes(agent.scales, scales):
        about["changed"] = changes
    observation = agent.start(env, seed, scales)
    with RolloutWriter(path, env, about) as writer:
        for step in agent.steps(env, observation):
            writer.step(step.observation, step.action, step.reward, step.info)
            if step.t + 1 == steps:
                break
    env.close()
    return writer.score
