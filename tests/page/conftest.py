import asyncio
import subprocess

import pytest

from tests.helpers.daemons import running_daemon
from tests.page.rig import RUNNING, Browser, Plant, page_url, restart

CONFIG = """
page: {port: 0, max_clients: 5}
plant: {safe_ramp_s: 0.1}
scheduler:
  realtime: {priority: 0, lock_memory: false, hold_latency_target: false}
  limits: {single_overrun_ms: null, consecutive_overruns: null}
  communication_timeout_ms: 0
"""


@pytest.fixture(scope="session")
def daemon(tmp_path_factory):
    """One daemon for all tests; each leaves it running, undriven and without faults."""
    with running_daemon(
        tmp_path_factory.mktemp("page"),
        config=CONFIG,
        ring_frames=1 << 14,
        program="tests.control.daemon",  # can hold its interpreter lock
        stdin=subprocess.PIPE,
    ) as daemon:
        yield daemon
        daemon.stop()


@pytest.fixture(scope="session")
def url(daemon):
    return page_url(daemon)


@pytest.fixture(scope="session")
def plant(daemon):
    return Plant(daemon.image)


@pytest.fixture(scope="session")
def chromium():
    browser = Browser(webgl=False)
    yield browser
    browser.close()


@pytest.fixture
def browser(chromium, daemon, plant):
    """A tab of its own in the one browser of all tests; afterwards it shows nothing.

    The robot runs again, whatever a test that failed before has left.
    """
    if plant.value("sim.state") != RUNNING:
        asyncio.run(restart(daemon.url))
    chromium.do("fresh")
    yield chromium
    chromium.do("leave")
