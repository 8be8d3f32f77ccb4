"""An FMU's process, seen from the plant: started, watched, restarted, ended.

It may end in any way at any time; the plant reads its answers from shared memory and never waits.
"""

import contextlib
import mmap
import os
import pickle
import select
import signal
import subprocess
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import hilserver.fmu.layout as at
from hilserver.fmu.description import Fmu
from hilserver.fmu.library import text_of
from hilserver.fmu.wiring import Wiring
from hilserver.kernel.composition import Setting
from hilserver.plant.blocks import BlockError
from hilserver.program import children

CHILD_START_S: Final = 60.0
SILENCE_S, LEAST_SLICES = 0.1, 10
"""With this much silence, as `exchange` counts it, and so many slices of it, it counts as dead."""
_NO_ANSWER: Final = "no longer answers and was ended"
_STOP_S: Final = 0.2


@dataclass(frozen=True)
class Order:
    """What a child is to do; sent to its standard input."""

    fmu: Fmu
    wiring: Wiring
    name: str
    setting: Setting
    # file descriptors: shared words, doorbell, pipe for its `Started`
    memory: int
    bell: int
    ready: int
    parent: int
    is_first: bool


@dataclass(frozen=True)
class Started:
    """What a child reports when it has started or failed to."""

    failure: str  # why it did not start; empty if it did
    initial: NDArray[np.float64]
    capacity: int
    n_words: int  # shared words


class Child:
    """The process; its memory and doorbell outlive it; BlockError if it does not start."""

    def __init__(self, fmu: Fmu, wiring: Wiring, name: str, setting: Setting) -> None:
        self._what = (fmu, wiring, name, setting)
        self._stores = fmu.stores_state
        self._memory = os.memfd_create(f"hilserver-fmu-{name}", os.MFD_CLOEXEC)
        self._bell = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._ready: int | None = None
        self._process = self._launch(is_first=True)
        try:
            started = self._wait()
        except BaseException:
            self.close()
            raise
        self._map = mmap.mmap(self._memory, 8 * started.n_words)
        self._words = np.frombuffer(self._map, dtype=np.int64)
        self.initial = started.initial  # `x` at time 0
        # `a` of the kernels of `exchange`
        self.addresses = self._addresses(started, setting)

    @property
    def message(self) -> str:
        """The FMU's message about its last error."""
        return text_of(self._words[at.S_MESSAGE : at.N_SHARED])

    def look(self, a: NDArray[np.int64], *, gives_up: bool) -> str | None:
        """Return how it ended (once), and restart it; None while it runs.

        Parameters
        ----------
        a : ndarray of int64
            The `a` of the step.
        gives_up : bool
            The step no longer waits: a process that does not answer is ended.
        """
        self._take_ready(a)
        running = self._process.poll() is None
        dead = bool(a[at.A_DEAD])
        if dead or (running and not gives_up):
            return None
        a[at.A_DEAD] = 1
        self._end()
        how = _how(self._process, was_killed=running)
        if self._stores and self._ready is None:
            self._process = self._launch(is_first=False)
        return how

    def close(self) -> None:
        """End it and free its memory."""
        self._end()
        for descriptor in (self._memory, self._bell, self._ready):
            if descriptor is not None:
                with contextlib.suppress(OSError):
                    os.close(descriptor)
        self._ready = None

    def _launch(self, *, is_first: bool) -> "subprocess.Popen[bytes]":
        self._ready, theirs = os.pipe()
        order = Order(
            *self._what, self._memory, self._bell, theirs, os.getpid(), is_first
        )
        try:
            process = subprocess.Popen(  # noqa: S603 - of ours
                children.python("-m", "hilserver.fmu.worker"),
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                pass_fds=(self._memory, self._bell, theirs),
                start_new_session=True,
            )
        finally:
            os.close(theirs)
        if process.stdin is not None:
            with contextlib.suppress(BrokenPipeError), process.stdin as pipe:
                pipe.write(pickle.dumps(order))
        return process

    def _wait(self) -> Started:
        """Return the report of the first child."""
        raw = b""
        ready = self._ready
        assert ready is not None
        while select.select([ready], [], [], CHILD_START_S)[0]:
            piece = os.read(ready, 1 << 16)
            raw += piece
            if not piece:
                break
        os.close(ready)
        self._ready = None
        if not raw:
            self._process.poll() if self._process.returncode is not None else self._end()
            raise BlockError(f"does not start: its process {_how(self._process)}")
        started: Started = pickle.loads(raw)  # noqa: S301 - of our own child
        if started.failure:
            raise BlockError(started.failure)
        return started

    def _take_ready(self, a: NDArray[np.int64]) -> None:
        """Note whether the child that replaces another has started."""
        if self._ready is None or not select.select([self._ready], [], [], 0)[0]:
            return
        has_started = bool(os.read(self._ready, 1 << 16))
        os.close(self._ready)
        self._ready = None
        if has_started:
            a[at.A_DEAD] = 0

    def _addresses(self, started: Started, setting: Setting) -> NDArray[np.int64]:
        a = np.zeros(at.ROWS, dtype=np.int64)
        a[at.A_SHARED] = self._words.ctypes.data
        a[at.A_SHARED_LENGTH] = started.n_words
        a[at.A_BELL] = self._bell
        a[at.A_ONE] = 1
        a[at.A_WAITS] = setting.waits
        a[at.A_LIMIT] = round(1e9 * longest_silence_s(setting.period_s))
        a[at.A_CAPACITY] = started.capacity
        return a

    def _end(self) -> None:
        process: Any = self._process
        if process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_STOP_S)


def longest_silence_s(period_s: float) -> float:
    """Return the silence [s], as `exchange` counts it, after which an FMU counts as dead."""
    return max(SILENCE_S, LEAST_SLICES * period_s)


def _how(process: "subprocess.Popen[bytes]", *, was_killed: bool = False) -> str:
    """Return how it ended; one that was dying when we killed it has its own reason."""
    code = process.returncode
    # SIGXCPU: the kernel ended it before we did, see `worker`.
    is_silence = code == -signal.SIGXCPU or (
        was_killed and code in (None, -signal.SIGKILL)
    )
    return _NO_ANSWER if is_silence else children.how_ended(code)
