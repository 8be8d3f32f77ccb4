"""The files of the town: recordings and snapshots, and whether they hold what they have to."""

import asyncio
import errno
from pathlib import Path

import hilserver.io.recorder.recorder
from hilserver.core.snapshot import read_snapshot
from hilserver.errors import ControlRefused, LogError
from hilserver.io.recorder.recorder import Recorder
from hilserver.io.recorder.series import Settings
from hilserver.io.recorder.source import BATCH_FRAMES
from hilserver.io.recorder.write_behind import Item, WriteBehind
from hilserver.logs.mcap_writer import CHUNKS_FOR_INDEX
from hilserver.logs.reading import read_log
from hilserver.replay import Comparison, Engine, assembly_of, plan_exact


class WriteAtOnce(WriteBehind):
    """Writes what it gets, and hands it to the disk, before it returns; it needs no thread."""

    safe = 0  # frames that the disk has for good while it writes the next ones

    def put(self, item: Item, *, wait: bool = False) -> bool:
        if self.error is not None:
            return False
        self.safe = self.written
        super().put(item, wait=wait)
        try:
            self._closing = True  # with what there is, it is done
            self._write_all()
            self._writer.sync()
            self._check(self._writer)
        except Exception as error:  # noqa: BLE001 - as in the thread
            self.error = error
            if getattr(error, "errno", None) == errno.ENOSPC:
                # so much of what was safe it gives up for the index of the file
                self.safe = max(self.safe - CHUNKS_FOR_INDEX * BATCH_FRAMES, 0)
            self._close_after_error()
        return True

    def close(self, timeout_s: float) -> bool:
        if self.error is None:
            try:
                self._writer.close()
            except Exception as error:  # noqa: BLE001 - as in the thread
                self.error = error
        return True

    def _run(self) -> None:
        """Open the file; nothing else is left for a thread."""
        self._begin()


def recorder_of(image: str, path: Path) -> Recorder:
    """Return a recorder of everything; its `look` has to be called once per ring of frames."""
    hilserver.io.recorder.recorder.WriteBehind = WriteAtOnce
    return Recorder(image, Settings(path=path, signals=("*",), waits=True))


def damaged(snapshots: Path) -> list[str]:
    """Return what is wrong with the snapshots of a folder, a sentence each."""
    found = []
    for path in sorted(snapshots.glob("*.npz")):
        try:
            read_snapshot(path)
        except ControlRefused as error:
            found.append(f"{path}: {error}")
    return found


def difference(path: Path, safe: int, *, lost_power: bool) -> str:
    """Replay a recording; return where its outputs differ, empty if nowhere.

    `safe`: so many frames the disk had for good; without any, there may be nothing to replay, and
    after a loss of power not even a readable file.
    """
    try:
        return asyncio.run(_difference(path, safe))
    except LogError as error:
        return "" if lost_power and not safe else str(error)


async def _difference(path: Path, safe: int) -> str:
    log = read_log(path)
    if len(log.t_s) < safe:
        return f"{len(log.t_s)} frames are left of {safe}"
    if not len(log.t_s):
        return ""
    assembly = assembly_of(log, None)
    period_ns = assembly.base_period_ns
    async with Engine(assembly) as engine:
        plan = plan_exact(log, engine.table, engine.image.layout, period_ns)
        comparison = Comparison(log, engine.table, period_ns)
        engine.feed_state(in_rows=plan.feeds_state)
        for stretch in plan.stretches:
            async for batch in engine.play(stretch):
                comparison.add(batch)
    if not comparison.n_ticks:
        return "nothing of it can be replayed"
    return comparison.difference or ""
