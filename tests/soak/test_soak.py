"""The demonstration with a recorder and a polling client, for as long as patience lasts.

Memory, descriptors, threads and tasks stay flat; simulated time stays with wall time to one period.
Half a minute in `make test`, an hour in `make test-long`.
"""

import asyncio
import os
import signal
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from hilserver.image import ImageReader
from hilserver.logs import read_log
from tests.helpers.daemons import finish, recorder, running_daemon
from tests.helpers.prom_diff import series_of_text
from tests.io.opcua_server.rig import RobotClient

PERIOD_NS = 1_000_000
SHORT_S, LONG_S = 30.0, 3600.0
SAMPLE_S = 2.0
POLL_S = 0.05
SETTLED = 0.25
"""Share of the run after which nothing may grow any more."""
GROWTH_MB_PER_H = 6.0
"""Twice of what an hour has shown."""
NOISE_MB = 3.0
BACKLOG_MB = 30.0
"""What a recorder that a busy computer holds up may have to write yet when the short one ends."""
CONFIG = """
scheduler:
  catch_up_limit: 10000
  communication_timeout_ms: 0
  limits: {single_overrun_ms: null, consecutive_overruns: null}
"""
"""What a busy computer took from the simulation, it gets back: no tick is ever left out."""
NODES = ("pose.x_m", "pose.y_m", "pose.yaw_rad", "sim.tick", "battery.voltage_v")


def rss_mb(pid):
    words = Path(f"/proc/{pid}/statm").read_text().split()
    return int(words[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def asyncio_tasks(metrics_url):
    """Tasks of the daemon's event loop, from its metrics."""
    with urllib.request.urlopen(metrics_url, timeout=120) as answer:
        series = series_of_text(answer.read().decode())
    return series["hil_asyncio_tasks", frozenset()]


def usage(pid):
    """Resident memory [MB], descriptors, threads."""
    return (
        rss_mb(pid),
        len(list(Path(f"/proc/{pid}/fd").iterdir())),
        len(list(Path(f"/proc/{pid}/task").iterdir())),
    )


async def poll(daemon, duration_s, pids):
    """Read nodes at 20 Hz; sample what the processes use and how time runs."""
    client = RobotClient(daemon.url)
    await client.connect()
    reader = ImageReader.attach(daemon.image)
    samples, times_ns, reads = [], [], 0
    start_s = time.monotonic()
    try:
        nodes = [client.path(name) for name in NODES]
        while (elapsed_s := time.monotonic() - start_s) < duration_s:
            assert all(v is not None for v in await client.read_values(nodes))
            reads += 1
            frame = reader.latest()
            times_ns.append(
                (frame.tick * PERIOD_NS, frame.planned_ns, time.monotonic_ns())
            )
            if elapsed_s >= len(samples) * SAMPLE_S:
                tasks = await asyncio.to_thread(asyncio_tasks, daemon.metrics_url)
                samples.append([(*usage(pid), tasks) for pid in pids])
            await asyncio.sleep(POLL_S)
    finally:
        await client.disconnect()
    return np.array(samples, dtype=float), np.array(times_ns), reads


def soak(tmp_path, duration_s):
    with running_daemon(tmp_path, "--demo", config=CONFIG) as daemon:
        recording = recorder(
            daemon, tmp_path / "soak.mcap", "--rotate-mb", "20", "--keep", "2"
        )
        pids = (daemon.process.pid, recording.pid)
        samples, times_ns, reads = asyncio.run(poll(daemon, duration_s, pids))
        recording.send_signal(signal.SIGTERM)
        code, text = finish(recording)
        assert code == 0, text
        assert daemon.stop() == 0
    report(samples, times_ns, reads, text, duration_s)
    assert "none lost" in text
    assert reads > duration_s
    files = sorted(tmp_path.glob("soak_*.mcap"))
    assert 1 <= len(files) <= 2
    assert len(read_log(files[-1]))
    return samples, times_ns


def report(samples, times_ns, reads, text, duration_s):
    """Print the figures that the documentation quotes."""
    settled = samples[int(SETTLED * len(samples)) :]
    for index, name in enumerate(("daemon", "recorder")):
        first, last = settled[0, index], settled[-1, index]
        print(
            f"{name}: {first[0]:.1f} -> {last[0]:.1f} MB, descriptors {first[1]:.0f} ->"
            f" {last[1]:.0f}, threads {first[2]:.0f} -> {last[2]:.0f}"
        )
    print(f"tasks of the daemon {settled[0, 0, 3]:.0f} -> {settled[-1, 0, 3]:.0f}")
    grid_ns, wall_ns = deviations_ns(times_ns)
    print(f"{duration_s:g} s, {reads} reads; {text.splitlines()[-1]}")
    print(f"simulated against wall time: grid {grid_ns} ns, as seen {wall_ns} ns")


def deviations_ns(times_ns):
    """By how much simulated time left the grid of planned starts, and the wall clock.

    The second is seen from outside through a scheduler of the system, which may show a tick late
    but never early: the promptest looks of the first and the last quarter are compared.
    """
    simulated, planned, wall = times_ns.T
    late = wall - simulated
    quarter = len(late) // 4
    return int(np.ptp(planned - simulated)), int(
        abs(late[-quarter:].min() - late[:quarter].min())
    )


def assert_flat(samples, duration_s, noise_mb=NOISE_MB):
    """No trend: the medians of the last quarter against those of the second."""
    quarter = len(samples) // 4
    early, late = samples[quarter : 2 * quarter], samples[-quarter:]
    growth = np.median(late, axis=0) - np.median(early, axis=0)
    assert (growth[:, 0] <= noise_mb + GROWTH_MB_PER_H * duration_s / 3600 / 2).all(), (
        growth
    )
    # A pool starts its threads one by one, when it needs them.
    assert (growth[:, 1] <= 1).all(), "descriptors grow"
    assert (growth[:, 2] <= 1).all(), "threads grow"
    assert (growth[:, 3] <= 1).all(), "tasks grow"


@pytest.mark.parametrize(
    ("duration_s", "noise_mb", "max_wall_ns"),
    [
        # A computer shared with other tests shows every tick late.
        pytest.param(SHORT_S, BACKLOG_MB, 20 * PERIOD_NS, id="half_a_minute"),
        pytest.param(
            LONG_S,
            NOISE_MB,
            PERIOD_NS,
            marks=[pytest.mark.long, pytest.mark.timeout(LONG_S + 300)],
            id="one_hour",
        ),
    ],
)
def test_nothing_grows_and_time_keeps_pace(tmp_path, duration_s, noise_mb, max_wall_ns):
    samples, times_ns = soak(tmp_path, duration_s)
    assert_flat(samples, duration_s, noise_mb)
    grid_ns, wall_ns = deviations_ns(times_ns)
    assert grid_ns < PERIOD_NS
    assert wall_ns < max_wall_ns


@pytest.mark.parametrize(
    ("figure", "per_h"),
    [(0, 4.0 * GROWTH_MB_PER_H), (1, 4.0), (2, 4.0), (3, 4.0)],
    ids=["memory", "descriptors", "threads", "tasks"],
)
def test_what_grows_in_an_hour_is_seen(figure, per_h):
    hours = np.linspace(0.0, 1.0, int(LONG_S / SAMPLE_S))
    samples = np.zeros((len(hours), 2, 4))
    samples[..., 0] = 200.0 + np.random.default_rng(0).uniform(
        0.0, NOISE_MB, samples.shape[:2]
    )
    assert_flat(samples, LONG_S)
    samples[:, 1, figure] += np.floor(per_h * hours) if figure else per_h * hours
    with pytest.raises(AssertionError):
        assert_flat(samples, LONG_S)
