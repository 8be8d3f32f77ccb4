"""Bags that hilserver wrote, back to logs without loss."""

import json
from pathlib import Path

import numpy as np

from hilserver.errors import LogError
from hilserver.logs import bag_topics as topics
from hilserver.logs import changes as sparse
from hilserver.logs.bag_messages import Bag, read_messages
from hilserver.logs.log import Log, RecordedState
from hilserver.logs.mcap_reader import Contents, to_log
from hilserver.logs.message import payload_dtype
from hilserver.ros.types import Types


def is_own_bag(path: Path) -> bool:
    """Return whether a bag holds our frames."""
    return any(topics.FRAMES in bag.topics for bag in read_messages(path, set()))


def read_own_bag(path: Path) -> Log:
    """Read one of our bags, a folder or its file; see `reading.read_log`."""
    bags = read_messages(
        path, {topics.FRAMES, topics.RUN, topics.STATES, topics.CHANGES}
    )
    types = Types()
    types.add(topics.STATE_TYPE, topics.STATE_TEXT)
    runs = _all(bags, topics.RUN)
    frames = _all(bags, topics.FRAMES)
    if not runs:
        raise LogError(
            f"{path}: contains no hilserver recording (no topic {topics.RUN}); give a mapping of"
            " its topics"
        )
    try:
        run = json.loads(types.decode(runs[-1], topics.RUN_TYPE).data)
        contents = Contents(names=list(run.pop("order")), run=run, ended=True)
        contents.configuration = run.pop("configuration", None)
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise LogError(
            f"{path}: its message on {topics.RUN} is damaged; record it again"
        ) from None
    dtype = payload_dtype(len(contents.names))
    if any(len(frame) != dtype.itemsize for frame in frames):
        raise LogError(
            f"{path}: the length of its frames does not match its list of signals; record it again"
        )
    contents.tables = [np.frombuffer(b"".join(frames), dtype=dtype)]
    for data in _all(bags, topics.STATES):
        state = types.decode(data, topics.STATE_TYPE)
        words = np.array(state.words, dtype=np.int64)
        contents.states.append(
            RecordedState(int(state.segment), int(state.tick), words)
        )
    for data in _all(bags, topics.CHANGES):
        contents.changes.append(
            sparse.from_text(types.decode(data, topics.RUN_TYPE).data)
        )
    notices = [notice for bag in bags for notice in bag.notices]
    return to_log(path, contents, notices)


def _all(bags: list[Bag], topic: str) -> list[bytes]:
    return [bytes(data) for bag in bags for _, data in bag.messages.get(topic, ())]
