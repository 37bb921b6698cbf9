"""Writes tensorboard.events with the `tensorboard` package of PyPI: the learner's writer must give the same.

    pip install tensorboard==2.21.0
    python tests/golden/tensorboard_events.py tests/golden/tensorboard.events

With a directory as its argument, prints instead what TensorBoard reads from the event files in it.
"""

import os
import sys

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter


def scalars(wall_time, step, pairs):
    values = [Summary.Value(tag=tag, simple_value=value) for tag, value in pairs]
    return Event(wall_time=wall_time, step=step, summary=Summary(value=values))


EVENTS = [
    Event(wall_time=1700000000.0, file_version="brain.Event:2"),
    Event(wall_time=1700000000.25, session_log=SessionLog(status=SessionLog.START)),
    scalars(1700000001.5, 1, [("train/loss", 0.125)]),
    scalars(1700000002.0, 300, [("rollout/ep_rew_mean", -3.4), ("time/fps", 0.0), ("bridge/len_mean", 1e30)]),
    # More than 127 bytes, so that lengths take two bytes, and a step beyond 32 bits.
    scalars(1700000003.0, 1 << 40, [(f"mentor/a_rather_long_name_{i:02}", float(i)) for i in range(8)]),
    Event(wall_time=1700000004.0, step=301, session_log=SessionLog(status=SessionLog.START)),
]


def main(path):
    if os.path.isdir(path):
        accumulator = EventAccumulator(path)
        accumulator.Reload()
        for tag in accumulator.Tags()["scalars"] + accumulator.Tags()["tensors"]:
            print(tag, [(event.step, event.value) for event in accumulator.Scalars(tag)])
        return
    with open(path, "wb") as file:
        writer = RecordWriter(file)
        for event in EVENTS:
            writer.write(event.SerializeToString(deterministic=True))


if __name__ == "__main__":
    main(sys.argv[1])
