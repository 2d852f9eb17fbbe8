"""Recordings of training runs and rollouts, as MCAP files that Rerun and Foxglove play.

    with RunWriter(path, {"experiment": "biped-morphology"}) as writer:
        writer.generation(Generation(0, mu, sigma, returns, steps, seeds, total_steps, seconds))
    record_rollout(agent, "rollout.mcap", seed=0)

    recording = read(path)
    recording.array("/summary", "mean")    # (G,) float64
    pandas.DataFrame(table(path))          # learning curve, evaluations and body by generation

What the messages hold, with units, is in `schema.proto` beside this file.
"""

from designrl.errors import optional

with optional("recordings", "view"):
    import foxglove_schemas_protobuf.FrameTransforms_pb2  # noqa: F401
    import lz4.frame  # noqa: F401
    import mcap.writer  # noqa: F401
    import mcap_protobuf.schema  # noqa: F401
    import zstandard  # noqa: F401

    import designrl.recording.schema_pb2  # noqa: F401 (an old protobuf refuses it)

from designrl.columns import write_table
from designrl.recording.mcap_file import RecordingError
from designrl.recording.reader import Recording, describe, read
from designrl.recording.rollout import RolloutWriter, record_rollout
from designrl.recording.run import Generation, RunWriter, thin
from designrl.recording.table import table

__all__ = [
    "Generation",
    "Recording",
    "RecordingError",
    "RolloutWriter",
    "RunWriter",
    "describe",
    "read",
    "record_rollout",
    "table",
    "thin",
    "write_table",
]
