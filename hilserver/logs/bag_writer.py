"""ROS 2 bags, with the package `rosbags`: MCAP or sqlite3.

``/hilserver/frame`` holds every signal as float64 with its status, so that nothing is lost; the
topics of the flavour are what a recorder would have seen beside the real robot.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from hilserver.errors import FailedError
from hilserver.logs import bag_topics as topics
from hilserver.logs import changes as sparse
from hilserver.logs.log import RecordedState
from hilserver.logs.message import CDR_LITTLE_ENDIAN, make_layout
from hilserver.logs.writer import Segmented, size_of
from hilserver.ros.types import Types
from hilserver.status import BAD

Storage = Literal["mcap", "sqlite3"]
BAG_VERSION: Final = 9


class BagWriter:
    """Writes one bag, a folder; see `LogWriter`; FailedError if it already exists."""

    def __init__(
        self,
        path: Path,
        run: Mapping[str, Any],
        slots: Sequence[int],
        utc_minus_monotonic_ns: int,
        storage: Storage = "mcap",
    ) -> None:
        if path.exists():
            raise FailedError(
                f"{path}: already exists; a bag needs a new folder: choose another name"
            )
        slot_of = {run["signals"][slot]["name"]: slot for slot in slots}
        self._layout = make_layout(list(slot_of))
        self._slots = np.array(
            [slot_of[name] for name in self._layout.names], dtype=np.intp
        )
        self._utc_ns, self._bytes = utc_minus_monotonic_ns, 0
        self._path, self._storage = path, storage
        self._types = Types()
        self._types.add(topics.FRAME_TYPE, self._layout.schema)
        self._types.add(topics.STATE_TYPE, topics.STATE_TEXT)
        self._robot = topics.RobotTopics(self._types, list(self._layout.names), run)
        self._writer = _opened(path, storage)
        self._held: list[tuple[str, bytes]] = []
        self._newest_ns: int | None = None
        self._is_open = True
        self._connections = {
            name: self._connect(name, kind)
            for name, kind in (
                (topics.FRAMES, topics.FRAME_TYPE),
                (topics.RUN, topics.RUN_TYPE),
                (topics.CHANGES, topics.RUN_TYPE),
                (topics.STATES, topics.STATE_TYPE),
                *((self._robot.absolute(p.topic), p.type) for p in self._robot.topics),
            )
        }
        self.tell(run)

    def _connect(self, name: str, kind: str) -> Any:
        return self._writer.add_connection(name, kind, typestore=self._types.store)

    @property
    def n_bytes(self) -> int:
        """Size of its files so far; sqlite3 writes most of a bag at its end."""
        return self._bytes if self._storage == "sqlite3" else size_of(self._path)

    def write(self, batch: Segmented) -> None:
        """Append a message for each frame, and the robot's if they are due."""
        frames = batch.frames
        table = np.zeros(len(frames), dtype=self._layout.dtype)
        table["cdr"] = CDR_LITTLE_ENDIAN
        table["number"], table["segment"] = frames.numbers, batch.segments
        table["tick"], table["planned_ns"] = frames.ticks, frames.planned_ns
        table["values"] = frames.values[:, self._slots]
        table["status"] = frames.status[:, self._slots]
        # the robot's messages hold what is known: a tag that is off has measured nothing
        known = np.where(table["status"] & BAD, np.nan, table["values"])
        stamps = (frames.planned_ns + self._utc_ns).tolist()
        if self._newest_ns is None:
            self._release(stamps[0])
        for row, values, stamp_ns, tick in zip(
            table, known, stamps, frames.ticks.tolist(), strict=True
        ):
            self._append(topics.FRAMES, stamp_ns, row.tobytes())
            for topic, message in self._robot.messages(tick, stamp_ns, values):
                name = self._robot.absolute(topic)
                self._append(name, stamp_ns, self._types.encode(message))
        for change in batch.changes:
            text = self._types.make(topics.RUN_TYPE, data=sparse.as_text(change))
            self._add(topics.CHANGES, self._types.encode(text))

    def _append(self, topic: str, stamp_ns: int, data: bytes) -> None:
        self._newest_ns = max(self._newest_ns or 0, stamp_ns)
        self._bytes += len(data)
        self._writer.write(self._connections[topic], stamp_ns, data)

    def _release(self, stamp_ns: int) -> None:
        """Write what came before the first frame: a bag begins with its first stamp."""
        self._newest_ns = stamp_ns
        held, self._held = self._held, []
        for topic, data in held:
            self._append(topic, stamp_ns, data)

    def _add(self, topic: str, data: bytes) -> None:
        if self._newest_ns is None:
            self._held.append((topic, data))
        else:
            self._append(topic, self._newest_ns, data)

    def add_state(self, state: RecordedState) -> None:
        """Append a state to replay from."""
        words = state.words.astype(np.int64)
        message = self._types.make(
            topics.STATE_TYPE, segment=state.segment, tick=state.tick, words=words
        )
        self._add(topics.STATES, self._types.encode(message))

    def tell(self, run: Mapping[str, Any]) -> None:
        """Say where the recording comes from; the last call counts."""
        text = json.dumps({**run, "order": list(self._layout.names)})
        message = self._types.make(topics.RUN_TYPE, data=text)
        self._add(topics.RUN, self._types.encode(message))

    def flush(self) -> None:
        """Leave it to the storage: MCAP is written chunk by chunk, sqlite3 at the end."""

    def sync(self) -> None:
        """Do as `flush` does."""

    def close(self) -> None:
        """Complete the bag; a second call does no harm."""
        if self._is_open:
            self._is_open = False
            if self._newest_ns is None:
                self._release(0)
            self._writer.close()


def _opened(path: Path, storage: Storage) -> Any:
    """Begin a bag; MCAP packs its chunks, as with ROS, to a tenth of their size."""
    from rosbags.rosbag2 import (  # noqa: PLC0415 -- slow to import
        CompressionFormat,
        CompressionMode,
        StoragePlugin,
        Writer,
    )

    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = Writer(path, version=BAG_VERSION, storage_plugin=plugin)
    if storage == "mcap":
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    writer.open()
    return writer
