"""What `bench jitter` measures: the daemon under OPC UA load, or the bare pacing loop.

A subject is a separate process. Its linear histogram is read from shared memory while it runs, as
the difference of two readings, so that the measurement does not load it.
"""

import contextlib
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from hilserver.errors import FailedError
from hilserver.image import ImageReader
from hilserver.program.children import free_port, piped, python
from hilserver.scheduler import Statistics, map_statistics

PACING_WITHIN_S = 120.0
SETTLES_S = 2.0
N_CLIENTS, N_NODES, RATE_HZ = 10, 50, 20


@dataclass(frozen=True)
class Place:
    """Where the daemon meets other programs it serves: files in a folder, the page at a port."""

    folder: Path
    port: int
    pacing_thread: int = 0  # thread id in the daemon, once it runs


@dataclass(frozen=True)
class Companion:
    """A program that the daemon serves in addition to its OPC UA clients."""

    section: str  # of the configuration; `settings` returns its content
    settings: Callable[[Place], Mapping[str, Any]]
    # runs a busy program at the other end while its context lasts; yields a description of it
    busy: Callable[[Place], contextlib.AbstractContextManager[str]]


@dataclass
class Subject:
    """A running process under measurement."""

    statistics: Statistics  # its figures, in shared memory
    # its load in words; completed when the load ends
    load: list[str] = field(default_factory=list)

    def measure(self, duration_s: float) -> NDArray[np.int64]:
        """Return the wake latencies of the next `duration_s` [s] in bins of 1 us."""
        before = self.statistics.linear_counts
        time.sleep(duration_s)
        counts = self.statistics.linear_counts - before
        if counts.sum() == 0:
            raise FailedError("the process under measurement has stopped pacing")
        return counts

    @property
    def priority(self) -> int:
        """SCHED_FIFO priority of the pacing thread; 0: none."""
        thread = self.statistics.thread_id
        # The flag that keeps children from inheriting the priority is reported with the policy.
        if os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK != os.SCHED_FIFO:
            return 0
        return os.sched_getparam(thread).sched_priority

    @contextlib.contextmanager
    def standing_back(self) -> Iterator[None]:
        """Let the pacing thread continue without its real-time priority.

        While cyclictest runs, the subject must remain the same load, but not compete with it at
        the same priority: the subject has no such competitor while it is measured.
        """
        priority = self.priority
        thread = self.statistics.thread_id
        if priority > 0:
            os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        try:
            yield
        finally:
            if priority > 0:
                policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(thread, policy, os.sched_param(priority))


@contextlib.contextmanager
def bare_pacing(
    backend: str, *, period_us: int, priority: int, beside: tuple[Companion, ...] = ()
) -> Iterator[Subject]:
    """Run the pacing loop with an empty step and a busy event loop."""
    if beside:
        raise FailedError("--with needs --subject daemon")
    with tempfile.TemporaryDirectory(dir="/dev/shm", prefix="hilserver-") as folder:
        path = Path(folder) / "statistics"
        module = "hilserver.bench.pacing_subject"
        arguments = ["-m", module, backend, str(path), str(period_us), str(priority)]
        with piped(python(*arguments), name="the pacing process") as process:
            statistics = _wait_for(
                lambda: Statistics.attach(map_statistics(path)), process
            )
            yield Subject(statistics, ["an event loop that packs and parses JSON"])


@contextlib.contextmanager
def loaded_daemon(
    backend: str, *, period_us: int, priority: int, beside: tuple[Companion, ...] = ()
) -> Iterator[Subject]:
    """Run the daemon and ten OPC UA clients that read 50 nodes at 20 Hz each."""
    with tempfile.TemporaryDirectory(prefix="hilserver-") as folder:
        port = free_port()
        image = f"bench-jitter-{os.getpid()}"
        url = f"opc.tcp://127.0.0.1:{port}/hilserver"
        path = Path(folder) / "config.yaml"
        place = Place(Path(folder), free_port())
        settings = _settings(backend, period_us, priority, image, url)
        settings |= {one.section: one.settings(place) for one in beside}
        path.write_text(yaml.safe_dump(settings), encoding="utf-8")
        arguments = ["-m", "hilserver", "run", "-c", str(path)]
        with piped(python(*arguments), name="hilserver run") as daemon:
            statistics = _wait_for(lambda: _statistics_of(image), daemon)
            load = ["-m", "hilserver.bench.opcua_load", url]
            load += [str(N_CLIENTS), str(N_NODES), str(RATE_HZ)]
            text = f"{N_CLIENTS} OPC UA clients, {N_NODES} nodes at {RATE_HZ} Hz each"
            clients_of = piped(python(*load), name="the OPC UA clients")
            with contextlib.ExitStack() as stack, clients_of as clients:
                place = replace(place, pacing_thread=statistics.thread_id)
                others = [stack.enter_context(one.busy(place)) for one in beside]
                subject = Subject(statistics, [text, *others])
                time.sleep(SETTLES_S)
                began = time.monotonic()
                yield subject
                subject.load.append(
                    _load_report(clients, time.monotonic() - began + SETTLES_S)
                )


def _settings(
    backend: str, period_us: int, priority: int, image: str, url: str
) -> dict[str, Any]:
    slices = {
        "plant": period_us / 1000,
        "sensors": 10 * period_us / 1000,
        "publish": 20 * period_us / 1000,
        "supervise": 100 * period_us / 1000,
    }
    return {
        "scheduler": {
            "backend": backend,
            "base_period_ms": period_us / 1000,
            "slices": slices,
            "policy": "skip",  # like cyclictest: one late wake-up is one sample
            "realtime": {"priority": priority},
            "limits": {
                "single_overrun_ms": None,
                "consecutive_overruns": None,
            },  # it keeps driving
        },
        "image": {"name": image},
        "opcua": {"endpoint": url},
        "metrics": {"enabled": False},
        "page": {"enabled": False},
        "logging": {"level": "ERROR"},
    }


def _statistics_of(image: str) -> Statistics:
    _, words = ImageReader.attach(image).region("statistics")
    return Statistics.attach(words)


def _load_report(clients: "subprocess.Popen[str]", duration_s: float) -> str:
    """End the clients and report how much of the load was actually achieved."""
    try:
        output, _ = clients.communicate(timeout=20)
    except subprocess.TimeoutExpired:
        raise FailedError(
            "the OPC UA clients did not end: the load is unknown"
        ) from None
    words = output.split()
    if clients.returncode != 0 or len(words) != 2:
        raise FailedError(
            "an OPC UA client failed during the measurement: the load was incomplete"
        )
    reads = int(words[0])
    late = int(words[1])
    wanted = N_CLIENTS * RATE_HZ * duration_s
    if reads < 0.8 * wanted:
        raise FailedError(
            f"only {reads} of about {wanted:.0f} reads took place: too little load"
        )
    return f"{reads} reads in {duration_s:.0f} s, {late} began a period too late"


def _wait_for(
    attach: Callable[[], Statistics], process: "subprocess.Popen[str]"
) -> Statistics:
    """Attach to a process that is starting, once its pacing thread runs."""
    deadline = time.monotonic() + PACING_WITHIN_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise FailedError(
                f"the process to be measured ended with code {process.returncode}"
            )
        with contextlib.suppress(FailedError, ValueError, OSError, KeyError):
            statistics = attach()
            if statistics.thread_id and statistics.linear_counts.sum() > 0:
                return statistics
        time.sleep(0.1)
    raise FailedError(
        f"the process to be measured did not start within {PACING_WITHIN_S:.0f} s"
    )
