"""A real browser drives; what counts is what the plant has latched."""

import os
import signal
import subprocess

import pytest

from tests.page.rig import DEADMAN_MS, page_url

pytestmark = [pytest.mark.page, pytest.mark.timeout(240)]
SLACK_S = 1.0
"""For a computer that others use as well; the figure itself is measured by hand."""
LIMIT_S = DEADMAN_MS * 1e-3 + 2 / 30 + SLACK_S


@pytest.fixture
def driving(browser, url, plant):
    """A browser that holds the arrow key: the robot moves."""
    browser.do("open", url=url)
    browser.do("take")
    browser.do("down", key="ArrowUp")
    plant.wait(lambda: plant.command() > 0.1)
    plant.wait(lambda: plant.value("velocity.linear_m_s") > 0.05)
    return browser


def ends(plant, within_s=LIMIT_S):
    took_s = plant.wait(lambda: plant.command() == 0.0, 10.0)
    print(f"zero after {took_s * 1e3:.0f} ms")
    assert took_s < within_s


def test_a_held_key_drives_and_letting_go_stops(driving, plant):
    ahead = plant.value("twist.linear_m_s")
    driving.do("down", key="ArrowLeft")
    plant.wait(lambda: plant.value("twist.angular_rad_s") > 0.1)  # left is counter-clockwise
    assert plant.value("twist.linear_m_s") == pytest.approx(ahead)
    driving.do("up", key="ArrowLeft")
    driving.do("up", key="ArrowUp")
    plant.wait(lambda: plant.command() == 0.0)
    assert driving.do("errors") == []


def test_s_stops_although_the_key_is_held(driving, plant):
    driving.do("press", key="s")
    plant.wait(lambda: plant.command() == 0.0)


def test_leaving_the_view_stops(driving, plant):
    driving.do("view", name="Watch")
    plant.wait(lambda: plant.command() == 0.0)


@pytest.mark.parametrize("how", ["mute", "cut", "freeze"])
def test_a_browser_that_falls_silent_is_stopped(driving, plant, how):
    driving.send(how)
    ends(plant)


def test_a_browser_that_is_stopped_is_stopped(driving, plant):
    group = driving.do("pid")
    os.killpg(group, signal.SIGSTOP)
    try:
        ends(plant)
    finally:
        os.killpg(group, signal.SIGCONT)


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_page_that_fails_is_stopped_and_the_daemon_runs_on(driving, plant, daemon, number):
    pages = subprocess.run(
        ["pgrep", "-P", str(daemon.process.pid), "-f", "hilserver page"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    os.kill(int(pages[0]), number)
    try:
        ends(plant)
    finally:
        if number == signal.SIGSTOP:
            os.kill(int(pages[0]), signal.SIGCONT)
    before = plant.value("sim.tick")
    plant.wait(lambda: plant.value("sim.tick") > before)
    driving.do("open", url=page_url(daemon))  # the page is there again


def test_the_emergency_stop_needs_no_webgl(driving, plant):
    assert driving.do("stage")
    driving.do("click", role="button", name="Stop emergency")
    plant.wait(lambda: plant.value("sim.state") == 3)
    driving.do("up", key="ArrowUp")
    driving.do("click", role="button", name="Reset")
    plant.wait(lambda: plant.value("sim.state") == 1)


def test_no_view_has_a_serious_fault_of_accessibility(browser, url):
    browser.do("open", url=url)
    for name in ("Drive", "Watch", "Signals", "Time", "Diagnosis"):
        browser.do("view", name=name)
        assert browser.do("axe") == [], name
