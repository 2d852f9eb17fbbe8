"""Recording one episode, in a way that any viewer of MCAP files draws."""

import math
from pathlib import Path

import gymnasium
import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from designrl.bodies import Body, relative
from designrl.design import changes_in_words
from designrl.names import agent_of
from designrl.numeric import real_numbers, whole_number
from designrl.policy import Agent
from designrl.recording import schema_pb2 as schema
from designrl.recording.mcap_file import END, ROLLOUT, McapFile, RecordingError
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
            `designrl replay` knows the body by. The environment's reward weights are added.

    Attributes:
        score: sum of the rewards so far.

    Raises (every method):
        RecordingError: the file cannot be written.
    """

    def __init__(self, path: str | Path, env, metadata: dict):
        self._env, self._step, self._shown_at, self.score = env.unwrapped, 0, None, 0.0
        self._shapes, self._is_entered = None, False
        self._file = McapFile(path)
        if weights := getattr(self._env, "reward_weights", None):
            metadata = {**metadata, "reward_weights": weights}
        self._file.metadata(ROLLOUT, metadata)  # first, so that a file that was cut has it
        try:
            self._write_start(metadata)
        except (AttributeError, TypeError) as error:
            raise RecordingError(
                f"what {path} is to record cannot be drawn ({error}); give an environment that has "
                "been reset, with a designrl.bodies.Body as its body"
            ) from error

    def _write_start(self, metadata: dict) -> None:
        self._body = body = self._env.body
        parts = list(body.tree)
        self._parent_indices = [parts.index(p) for p in list(body.tree.values())[1:]]
        robot = "/robot_description"
        self._file.add_channel(robot, "std_msgs/msg/String", "ros2msg", b"string data\n", {})
        description = body.urdf(self._env.design, _caption(metadata, body, self._env.design))
        self._file.message(robot, 0, 0, _cdr_string(description))
        if (terrain := body.terrain(self._env)) is not None:
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
            info: of the environment; "reward_terms" holds the parts of the reward by their names,
                if any, the same at each step.

        Raises:
            RecordingError: values that are not those that the body names or that the first step
                had, or no numbers; or the writer's `with` has not begun, or has ended.
        """
        if not self._is_entered:
            raise self._refused("is outside of `with RolloutWriter(...) as writer:`")
        body, env, before = self._body, self._env, self._now()
        try:
            terms = dict(info.get("reward_terms", {"reward": reward}))
            names = list(terms) if self._shapes is None else self._terms
            parts = [terms.pop(name) for name in names]
            reward, *parts = real_numbers([reward, *parts]).tolist()
            seen, done = (np.float32(real_numbers(a)).tolist() for a in (observation, action))
        except KeyError as error:
            raise self._refused(f"lacks the reward term {error}, which the first one has") from None
        except (AttributeError, TypeError, ValueError) as error:
            raise self._refused(f"has a value that is no number ({error})") from None
        if terms:
            raise self._refused(f"has reward terms that the first has not: {', '.join(terms)}")
        if not np.isfinite([self.score + reward, *parts]).all():
            raise self._refused(f"has a reward of {reward}, with the parts {parts}")
        rewards = {"reward": reward, "total": self.score + reward, "terms": parts}
        found = [
            (schema.Observation, body.observations, {"values": seen}),
            (schema.Action, body.joints, {"values": done}),
            (schema.Reward, names, rewards),
        ]
        if (states := body.joint_states(env)) is not None:
            fields = dict(zip(("angles", "speeds", "torques"), states, strict=True))
            found.append((schema.Joints, body.joints, fields))
        if (touching := body.contacts(env)) is not None:
            found.append((schema.Contacts, body.contact_names, {"touching": touching}))
        if (rays := body.lidar(env)) is not None:
            (x, z), (end_x, end_z) = rays[0, 0].tolist(), rays[:, 1].T.tolist()
            ends = {"end_x": end_x, "end_z": end_z}
            found.append((schema.Lidar, (), {"origin_x": x, "origin_z": z, **ends}))
        self._check_shapes(found)
        step, self._terms, self.score = self._step, names, rewards["total"]
        self._step += 1
        for kind, names, fields in found:
            at = before if kind in (schema.Observation, schema.Action) else self._now()
            self._file.write(kind(step=step, **fields), at, step, names)
        self._write_poses()

    def _check_shapes(self, found) -> None:
        """As many values as they have names, and as the first step had."""
        shapes, expected = {}, self._shapes or {}
        for kind, names, fields in found:
            for field, value in fields.items():
                key = f"/{kind.DESCRIPTOR.name.lower()} {field}"
                shapes[key] = np.shape(value)
                if self._shapes is None:
                    is_scalar = field in ("reward", "total")
                    expected[key] = (len(names),) if names and not is_scalar else shapes[key]
        wrong = [key for key in {**expected, **shapes} if expected.get(key) != shapes.get(key)]
        if wrong:
            key = wrong[0]
            raise self._refused(
                f"has values of the shape {shapes.get(key)} for {key}, where the body or the first "
                f"step has {expected.get(key)}"
            )
        self._shapes = expected

    def _refused(self, why: str) -> RecordingError:
        return RecordingError(f"step {self._step} of {self._file.path} {why}; it is not recorded")

    def __enter__(self) -> "RolloutWriter":
        self._is_entered = True
        return self

    def __exit__(self, kind, error, traceback) -> None:
        """Put the file in place, unless the episode has failed."""
        self._is_entered = False
        try:
            if kind is None:
                self._file.metadata(ROLLOUT, {"score": self.score, "steps": self._step})
                self._file.metadata(END, {"finished": "true"})
                self._file.publish()
        finally:
            self._file.close()


def _caption(metadata: dict, body: Body, scales: np.ndarray) -> str:
    """What stands above the URDF; viewers show it as text beside the picture."""
    lines = [f"{key}: {metadata[key]}" for key in ("experiment", "seed") if key in metadata]
    if metadata.get("changed"):
        lines.append(f"not the agent's own body: {changes_in_words(metadata['changed'])}")
    if "body" in metadata:
        lines.append(f"body, in {body.design.unit}:")
        sizes = zip(body.design.names, body.design.dimensions(scales), strict=True)
        lines += [f"  {name}: {size:.4g}" for name, size in sizes]
    return "\n".join(["designrl rollout", *lines])


def record_rollout(
    agent: Agent | str | Path,
    path: str | Path,
    seed: int,
    steps: int | None = None,
    design=None,
    reward_weights=None,
) -> float:
    """Roll an agent out once and record that.

    Args:
        agent: from `designrl.load`, or what that takes.
        path: the file to write.
        seed: of the environment and of the policy's noise; `designrl.evaluation.episode_seeds`
            has those of an evaluation.
        steps: how many to record at most; None: the whole episode.
        design: the body to walk with, as `Agent.body_with` takes it; None: its own.
        reward_weights: of the environment's reward terms, as it takes them.

    Returns: the score of what is recorded, without any other training-time change of the reward.

    Raises:
        InputError: no agent, the seed is no whole number from 0 on, no design of the body, or
            weights that the environment refuses.
        RecordingError: the file cannot be written.
    """
    seed, agent = whole_number("the seed", seed, 0), agent_of(agent)
    space, scales = agent.experiment.body.design, agent.body_with(design)
    kwargs = {**agent.env_kwargs, **({"reward_weights": reward_weights} if reward_weights else {})}
    env = gymnasium.make(agent.experiment.env_id, disable_env_checker=True, **kwargs)
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
