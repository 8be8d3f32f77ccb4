import pytest

from tests.helpers.daemons import running_daemon
from tests.page.rig import Browser, Plant, page_url

CONFIG = """
page: {port: 0, max_clients: 5}
scheduler:
  realtime: {priority: 0, lock_memory: false, hold_latency_target: false}
  limits: {single_overrun_ms: null, consecutive_overruns: null}
  communication_timeout_ms: 0
"""


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    with running_daemon(tmp_path_factory.mktemp("page"), config=CONFIG) as daemon:
        yield daemon
        daemon.stop()


@pytest.fixture(scope="module")
def url(daemon):
    return page_url(daemon)


@pytest.fixture(scope="module")
def plant(daemon):
    return Plant(daemon.image)


@pytest.fixture
def browser():
    browser = Browser(webgl=False)
    yield browser
    browser.close()
