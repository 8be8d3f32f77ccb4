"""Snapshots: the whole state, saved in a file and restored bit for bit.

A snapshot holds every signal, every state of plant, sensors and own blocks, and the parameters in
force. It carries version, kernel hash, signal names and configuration of the run; if any of them
differs, a restore is refused.
"""

import asyncio
import hashlib
import io
import json
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver import __version__
from hilserver.compiled import kernel_hash
from hilserver.errors import ControlRefused
from hilserver.image import ProcessImage
from hilserver.image.layout import (
    REQUEST_LOAD,
    REQUEST_RESTART,
    REQUEST_SAVE,
)
from hilserver.image.requests import is_done, post_request
from hilserver.kernel.adoption import unfit
from hilserver.program.whole_file import write_whole

SCHEMA = "hilserver.core.snapshot/1"
OF_THE_RUN = ("config_sha256", "patch", "seed", "audit")
"""What a snapshot records of its run besides its identity, for information only."""
_DAMAGED = (
    OSError, ValueError, LookupError, MemoryError, EOFError, RuntimeError, SyntaxError, TypeError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What NumPy and zipfile raise on a file that is not theirs."""
MOST_BYTES = 1 << 26  # unpacked size limit of a snapshot; a state has less than 1 MB
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_SERVED_WITHIN_S = 2.0
# files in the folder: callers of SaveSnapshot must not fill the disk
MOST_SNAPSHOTS = 100


class SnapshotStore:
    """Saves and restores the live regions of a process image.

    The values of `parameters` must agree between the saving and the loading run.
    """

    def __init__(
        self, image: ProcessImage, folder: Path, parameters: dict[str, Any]
    ) -> None:
        self._image = image
        self._folder = folder
        layout = json.dumps(image.description["signals"], sort_keys=True).encode()
        # version, kernels and signals of this run, and `parameters`
        self.identity: dict[str, Any] = {
            "version": __version__,
            "kernels": kernel_hash(),
            "signals": hashlib.sha256(layout).hexdigest(),
        } | parameters
        self.initial = self._image.live.copy()  # the state before the first tick
        self.is_restoring = False  # whether a state is on its way into the plant
        # called after a state was restored
        self.restored: list[Callable[[], None]] = []
        self._lock = asyncio.Lock()

    def reset(self) -> None:
        """Put everything back to the state before the first tick, at tick 0.

        ControlRefused while a snapshot is being saved or loaded: both use the shadow copy.
        """
        if self._lock.locked():
            raise ControlRefused(
                "Reset is not possible yet: a snapshot is being saved or loaded"
            )
        self._image.shadow[:] = self.initial
        post_request(REQUEST_RESTART, 0, self._image.words)

    async def save(self, name: str) -> Path:
        """Save the state between two ticks; return the file.

        ControlRefused if the name is not a plain file name, the plant does not answer, there are
        `MOST_SNAPSHOTS` already, or it cannot be written to disk.
        """
        path = self._path(name)
        others = set(self._folder.glob("*.npz")) - {path}
        if len(others) >= MOST_SNAPSHOTS:
            raise ControlRefused(
                f"there are {len(others)} snapshots in {self._folder}; remove some first"
            )
        async with self._lock:
            await self._serve(REQUEST_SAVE, 0)
            tick = self._image.control.request_tick
            state = self._image.shadow.copy()
        run = self._image.description["run"]
        meta = {
            "schema": SCHEMA,
            "tick": tick,
            "identity": self.identity,
            "sha256": _sum(state),
        }
        meta |= {key: run.get(key) for key in OF_THE_RUN}
        try:
            await asyncio.to_thread(_write, path, state, meta)
        except OSError as error:
            raise ControlRefused(
                f"{path}: cannot be written: {error.strerror}"
            ) from None
        return path

    async def load(
        self, name: str, *, end_commands: Callable[[], None] | None = None
    ) -> int:
        """Continue from a saved state; return its tick.

        `end_commands` is called before the plant jumps, which ends every lease; None: they go on.

        ControlRefused if the file is absent, damaged, or of a run that differs.
        """
        path = self._path(name)
        state, meta = await asyncio.to_thread(read_snapshot, path)
        if (key := self.differs_in(meta["identity"])) is not None:
            made_with = _short(meta["identity"].get(key))
            here = _short(self.identity[key])
            raise ControlRefused(
                f"snapshot '{name}' was made with {key} {made_with}, this"
                f" run has {here}; use the configuration it was made with"
            )
        if state.shape != self._image.shadow.shape:
            raise ControlRefused(f"snapshot '{name}' holds a state of a different size")
        await self.restore(state, int(meta["tick"]), end_commands=end_commands)
        return int(meta["tick"])

    async def capture(self) -> int:
        """Leave a copy of the state in shared memory, for a recorder; return its tick."""
        async with self._lock:
            await self._serve(REQUEST_SAVE, 0)
            return self._image.control.request_tick

    async def restore(
        self,
        state: NDArray[np.int64],
        tick: int,
        *,
        end_commands: Callable[[], None] | None = None,
    ) -> None:
        """Continue from `state`, as held by a snapshot or a recording, at `tick`; see `load`.

        ControlRefused if the plant could not continue from it.
        """
        layout = self._image.layout
        if (what := unfit(state, layout.regions, layout.n_slots)) is not None:
            raise ControlRefused(f"the state is damaged ({what}); use another file")
        async with self._lock:
            self.is_restoring = True
            try:
                self._image.shadow[:] = state
                if end_commands is not None:
                    end_commands()
                await self._serve(
                    REQUEST_LOAD if end_commands is None else REQUEST_RESTART, tick
                )
                for follow in self.restored:
                    follow()
            finally:
                self.is_restoring = False

    def differs_in(self, identity: Mapping[str, Any]) -> str | None:
        """Return the first key in which another run's identity differs, None if none does."""
        return next((k for k, v in self.identity.items() if identity.get(k) != v), None)

    @property
    def state_words(self) -> int:
        """Length of a state in words of 8 bytes."""
        return self._image.control.live_length

    def _path(self, name: str) -> Path:
        if not _NAME.fullmatch(name):
            raise ControlRefused(
                f"{name!r:.120} is not a plain file name (letters, digits, _ . -)"
            )
        return self._folder / f"{name.removesuffix('.npz')}.npz"

    async def _serve(self, kind: int, tick: int) -> None:
        number = post_request(kind, tick, self._image.words)
        deadline = asyncio.get_running_loop().time() + _SERVED_WITHIN_S
        while not is_done(number, self._image.words):
            if asyncio.get_running_loop().time() > deadline:
                raise ControlRefused(
                    f"the plant did not answer within {_SERVED_WITHIN_S:g} s"
                )
            await asyncio.sleep(0.001)


def _short(value: Any) -> str:
    text = json.dumps(value)
    if len(text) <= 40:
        return text
    return text[:37] + "..."


def _write(path: Path, state: NDArray[np.int64], meta: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    packed = io.BytesIO()
    np.savez(packed, state=state, meta=np.array(json.dumps(meta)))
    write_whole(path, packed.getvalue())


def read_snapshot(path: Path) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """Return state and description of a snapshot file.

    ControlRefused if the file is absent or damaged.
    """
    try:
        with zipfile.ZipFile(path) as packed:  # members end where they declare to end
            if sum(part.file_size for part in packed.infolist()) > MOST_BYTES:
                raise ControlRefused(
                    f"snapshot '{path.stem}' unpacks to more than {MOST_BYTES >> 20} MB, more than"
                    f" any state needs; use another"
                )
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            state: NDArray[np.int64] = archive["state"]
            meta: dict[str, Any] = json.loads(str(archive["meta"]))
    except FileNotFoundError:
        raise ControlRefused(f"there is no snapshot '{path.stem}'") from None
    except _DAMAGED:
        raise ControlRefused(f"snapshot '{path.stem}' is damaged") from None
    is_ours = isinstance(meta, dict) and meta.get("schema") == SCHEMA
    if not is_ours or not isinstance(state, np.ndarray) or state.dtype != np.int64:
        raise ControlRefused(f"snapshot '{path.stem}' does not follow schema {SCHEMA}")
    if meta.get("sha256", _sum(state)) != _sum(state):  # older files have none
        raise ControlRefused(f"snapshot '{path.stem}' is damaged: its checksum differs")
    return state, meta


def _sum(state: NDArray[np.int64]) -> str:
    return hashlib.sha256(state.tobytes()).hexdigest()
