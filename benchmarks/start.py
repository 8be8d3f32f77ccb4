"""Time from the command line to the first tick, and memory of daemon and page.

The reference is a process that only imports the daemon's libraries. On a busy computer the
processor time of the start is a better measure than the elapsed time.
"""

import argparse
import contextlib
import os
import re
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import yaml

from hilserver.bench.report import Result
from hilserver.errors import FailedError
from hilserver.image import ImageReader
from hilserver.program.children import free_port, piped, python

LIBRARIES = "numba, asyncua, aiohttp, pydantic, prometheus_client, structlog"
IMPORTS = f"import {LIBRARIES}, time; print(open('/proc/self/status').read(), time.process_time())"
COLD_S, WARM_S = 900.0, 60.0
TICK_AGAIN_S = 0.005
RESTING_S = 3.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument("--runs", type=int, default=5, help="warm starts (default 5)")
    parser.add_argument(
        "--cold", type=int, default=0, help="starts with an empty cache first"
    )


def run(args: argparse.Namespace) -> list[Result]:
    """Start the daemon with its page repeatedly."""
    cold = []
    for _ in range(args.cold):
        with tempfile.TemporaryDirectory(prefix="hilserver-cache-") as empty:
            start = _start(COLD_S, HILSERVER_CACHE_DIR=empty)
            cold.append(start | {"units": _units(Path(empty))})
    _start(COLD_S)  # fills the cache of this version
    warm, libraries = [], []
    # in turns: the speed of a shared computer changes within the minute that this takes
    for _ in range(args.runs):
        warm.append(_start(WARM_S))
        libraries.append(_import())
    results = []
    if cold:
        results.append(Result("start_cold_s", _median(cold, "s"), "s", raw=cold))
        results.append(Result("start_compiled_units", _median(cold, "units"), "units"))
    for name, unit, key in (
        ("start_warm_s", "s", "s"),
        ("start_warm_cpu_s", "s", "cpu_s"),
        ("memory_daemon_mb", "MB", "mb"),
    ):
        value, reference = _median(warm, key), _median(libraries, key)
        results.append(
            Result(
                name,
                value,
                unit,
                reference,
                "import of its libraries",
                value / reference,
            )
        )
    page = _median(warm, "page_mb")
    together = statistics.median(start["mb"] + start["page_mb"] for start in warm)
    return [
        *results,
        Result("memory_page_mb", page, "MB"),
        Result(
            "memory_together_mb",
            together,
            "MB",
            raw={"warm": warm, "libraries": libraries},
        ),
    ]


def _median(starts: Sequence[Mapping[str, float]], key: str) -> float:
    return statistics.median(start[key] for start in starts)


def _units(cache: Path) -> int:
    """Return how many compiled functions a cache holds, whichever signatures they have."""
    return sum(1 for _ in cache.rglob("*.nbc"))


def _start(limit_s: float, **environment: str) -> dict[str, float]:
    """Return seconds and processor time to the first tick, and the memory of daemon and page."""
    image = f"bench-start-{os.getpid()}"
    settings = {
        "image": {"name": image},
        "opcua": {"endpoint": f"opc.tcp://127.0.0.1:{free_port()}/hilserver"},
        "metrics": {"enabled": False},
        "page": {"port": free_port()},
        "logging": {"level": "ERROR"},
    }
    with tempfile.TemporaryDirectory(prefix="hilserver-") as folder:
        path = Path(folder) / "config.yaml"
        path.write_text(yaml.safe_dump(settings), encoding="utf-8")
        begin = time.monotonic()
        command = python("-m", "hilserver", "run", "-c", str(path))
        env = {**os.environ, **environment}
        with piped(
            command, name="hilserver run", env=env, stderr=subprocess.DEVNULL
        ) as daemon:
            _wait_for_tick(image, daemon, begin + limit_s)
            seconds, cpu_s = time.monotonic() - begin, _cpu_s(daemon.pid)
            time.sleep(RESTING_S)
            pages = [pid for pid in _children(daemon.pid) if b"page" in _command(pid)]
            if not pages:
                raise FailedError(
                    "the daemon that was started for the bench has no page"
                )
            page_mb = _megabytes(_status(pages[0]))
            return {
                "s": seconds,
                "cpu_s": cpu_s,
                "mb": _megabytes(_status(daemon.pid)),
                "page_mb": page_mb,
            }


def _wait_for_tick(
    image: str, daemon: "subprocess.Popen[str]", deadline: float
) -> None:
    while time.monotonic() < deadline and daemon.poll() is None:
        with contextlib.suppress(FailedError):
            if ImageReader.attach(image).head > 0:
                return
        time.sleep(TICK_AGAIN_S)
    raise FailedError(
        "the daemon that was started for the bench did not reach its first tick"
    )


def _import() -> dict[str, float]:
    begin = time.monotonic()
    done = subprocess.run(  # noqa: S603
        python("-c", IMPORTS), capture_output=True, text=True, check=True
    )
    seconds, cpu_s = time.monotonic() - begin, float(done.stdout.split()[-1])
    return {"s": seconds, "cpu_s": cpu_s, "mb": _megabytes(done.stdout)}


def _children(pid: int) -> Iterator[int]:
    for task in Path(f"/proc/{pid}/task").iterdir():
        yield from map(int, (task / "children").read_text(encoding="ascii").split())


def _command(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


def _status(pid: int) -> str:
    return Path(f"/proc/{pid}/status").read_text(encoding="ascii")


def _cpu_s(pid: int) -> float:
    fields = (
        Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    )
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _megabytes(status: str) -> float:
    """Return the resident memory from the text of /proc/PID/status [MB]."""
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    return 0.0 if found is None else int(found[1]) * 1.024e-3
