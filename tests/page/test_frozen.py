"""The page tells what is: a daemon or a page that stands still, and what is pressed meanwhile."""

import asyncio
import contextlib
import os
import signal
import time

import pytest

from tests.page.rig import SAFE, page_process, reset
from tests.page.test_security import visitor  # noqa: F401 - a fixture

ALARM = ".alarm p"


@contextlib.contextmanager
def frozen(pid):
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


@pytest.fixture
def driver(browser, url, plant):
    browser.do("open", url=url)
    browser.do("take")
    yield browser
    plant.wait(lambda: plant.value("sim.state") == SAFE)
    reset(browser, plant)


@pytest.mark.page
def test_a_frozen_daemon_is_shown_as_such_and_confirms_no_stop(
    driver, plant, daemon, tmp_path
):
    """Before, the page showed "running", "You drive" and full numbers, and confirmed a Stop."""
    with frozen(daemon.process.pid):
        driver.do("wait", selector="body.stale .banner", text="No answer for")
        driver.do("wait", selector=".state", text="no answer")
        driver.do("wait", selector=".owner", text="Who drives is not known")
        pressed_s = time.monotonic()
        driver.do("press", key="x")
        driver.do("wait", selector=ALARM, text="sent, not confirmed")
        print(f"said after {time.monotonic() - pressed_s:.2f} s")
        driver.do("shot", path=os.environ.get("SHOT", str(tmp_path / "frozen.png")))
        driver.do("rest", ms=1000)
        assert "not confirmed" in driver.do("text", selector=ALARM)
    driver.do("wait", selector=ALARM, text="confirmed after")
    driver.do("wait", selector=".state", text="safe")
    driver.do("rest", ms=7000)  # longer than a toast stays
    assert driver.do("run", script="document.querySelectorAll('.alarm').length") == 1
    driver.do("click", role="button", name="Understood")
    assert driver.do("run", script="document.querySelectorAll('.alarm').length") == 0
    assert driver.do("errors") == []


@pytest.mark.page
def test_a_frozen_page_confirms_no_stop(driver, plant, daemon):
    with frozen(page_process(daemon)):
        driver.do("press", key="x")
        driver.do("wait", selector=ALARM, text="sent, not confirmed")
        driver.do("rest", ms=500)
    driver.do("wait", selector=ALARM, text="confirmed after")
    driver.do("click", role="button", name="Understood")


@pytest.mark.parametrize("seconds", [6.0, pytest.param(25.0, marks=pytest.mark.long)])
async def test_what_was_told_as_failed_is_not_done_later_and_the_way_heals(
    visitor,  # noqa: F811
    daemon,
    seconds,
):
    """Before, every action failed for minutes, and the snapshot was there all the same."""
    await visitor.call("session")
    end_s = time.monotonic() + seconds
    name = f"late-{seconds:.0f}"
    with frozen(daemon.process.pid):
        status, answer = await visitor.call("SaveSnapshot", name)
        assert status == 409
        assert answer["text"].startswith("the daemon does not answer: ")
        assert answer["text"].endswith("4 s")
        await asyncio.sleep(max(0.0, end_s - time.monotonic()))
    assert (await visitor.call("ResetStatistics"))[1] == {"ok": True, "result": None}
    assert (await visitor.call("SaveSnapshot", "in-time"))[1]["ok"]
    names = [path.stem for path in (daemon.folder).rglob("*.npz")]
    assert "in-time" in names
    assert name not in names
