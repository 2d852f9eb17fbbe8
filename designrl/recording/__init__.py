"""Recordings of training runs and rollouts, as MCAP files that Rerun and Foxglove play.

    with RunWriter(path, {"experiment": "biped-morphology"}) as writer:
        writer.generation(Generation(0, mu, sigma, returns, steps, seeds, total_steps, seconds))
    record_rollout(agent, "rollout.mcap", seed=0)

    recording = read(path)
    recording.array("/summary", "mean")    # (G,) float64
    pandas.DataFrame(table(path))          # learning curve, evaluations and body by generation

What the messages hold, with units, is in `schema.proto` beside this file.
"""

from designrl.recording.mcap_file import RecordingError
from designrl.recording.reader import Recording, describe, read
from designrl.recording.rollout import RolloutWriter, record_rollout
from designrl.recording.run import Generation, RunWriter, thin
from designrl.recording.table import table, write_table

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
