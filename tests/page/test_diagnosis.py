"""Choose a log, follow the diagnosis, read its report, load the patch: the live gap falls."""

import asyncio
import contextlib
import os
import re
import subprocess
import threading
from pathlib import Path

import pytest
import yaml
from asyncua import ua
from hilserver_injector import Recipe, make

from tests.io.opcua_server.rig import RobotClient
from tests.page.test_driving import page_process

pytestmark = [pytest.mark.page, pytest.mark.timeout(600)]
GAIN = 0.15
TURN_RAD_S = 0.3
LONG_S = 400


class RealRobot:
    """Tells the simulation what to do, and what the real robot does then: it turns 15 % more."""

    def __init__(self, url):
        self._url, self._end = url, threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    def __enter__(self):
        self._thread.start()

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()

    async def _run(self):
        client = RobotClient(self._url)
        await client.connect()
        await client.write(("control.source", "opcua", ua.VariantType.String))
        await client.write(("control.mode", 1, ua.VariantType.Byte))
        await client.write_doubles(twist__linear_m_s=0.15, twist__angular_rad_s=TURN_RAD_S)
        turn = TURN_RAD_S * (1 + GAIN)
        while not self._end.is_set():
            await client.write_doubles(measured__velocity__angular_rad_s=turn)
            await asyncio.sleep(0.1)
        await client.write_doubles(twist__linear_m_s=0.0, twist__angular_rad_s=0.0)
        await client.disconnect()


@pytest.fixture(scope="module")
def log(daemon):
    folder = daemon.folder / "recordings"
    folder.mkdir(exist_ok=True)
    table, _ = make(Recipe(seed=3, causes={"rotation_gain": GAIN}, duration_s=20.0))
    table.write_csv(folder / "turns.csv")
    return "turns.csv"


@pytest.fixture
def worker(daemon):
    """The process of the diagnosis that runs now, if one does."""

    def look():
        words = ["pgrep", "-P", str(page_process(daemon)), "-f", "diagnose"]
        found = subprocess.run(words, check=False, capture_output=True, text=True)
        return [int(pid) for pid in found.stdout.split()]

    return look


def lift(pid):
    """On a busy computer it would get no time at all; where we may, it gets some."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, pid, 0)
        Path(f"/proc/{pid}/autogroup").write_text("0", encoding="ascii")


def begin(browser, url, plant, worker):
    browser.do("open", url=url)
    browser.do("view", name="Diagnosis")
    browser.do("click", role="button", name="Diagnose turns.csv")
    plant.wait(lambda: len(worker()) == 1)
    (pid,) = worker()
    plant.wait(lambda: os.sched_getscheduler(pid) == os.SCHED_IDLE)
    return pid


def test_a_diagnosis_is_cancelled_from_the_page(browser, url, plant, worker, log):
    begin(browser, url, plant, worker)
    browser.do("wait", selector=".jobs progress")
    browser.do("click", role="button", name="Cancel")
    browser.do("wait", selector=".jobs .chip", text="cancelled")
    plant.wait(lambda: not worker())


@pytest.mark.long  # at idle priority a diagnosis takes as long as others let it
def test_from_the_log_to_the_loaded_patch(browser, url, plant, worker, daemon, log):
    pid = begin(browser, url, plant, worker)
    lift(pid)
    browser.do("wait", selector=".jobs .hint", text="%")
    plant.wait(lambda: not worker(), LONG_S)
    browser.do("click", role="button", name="Read the report")
    assert re.search(r"turns 1\d % more", browser.do("framed", selector="body"))
    browser.do("click", role="button", name="Load the patch")
    browser.do("wait", selector="[aria-label='Patch']", text="is loaded.")
    browser.do("click", role="button", name="Remove the patch")
    browser.do("wait", selector="[aria-label='Patch']", text="No patch is loaded.")
    assert browser.do("errors") == []


def test_with_the_patch_the_live_gap_falls(browser, url, plant, daemon):
    made = {"findings_sha256": "", "config_sha256": "", "version": "1"}
    terms = {"rotation_gain": {"value": GAIN, "unit": "1"}}
    patch = {"schema": "hilserver.model_patch/1", "made_from": made, "terms": terms}
    folder = daemon.folder / "patches"
    folder.mkdir(exist_ok=True)
    (folder / "turn.yaml").write_text(yaml.safe_dump(patch), encoding="utf-8")
    browser.do("open", url=url)
    browser.do("view", name="Diagnosis")
    with RealRobot(daemon.url):
        browser.do("wait", selector="[data-gap]", text="velocity.angular_rad_s")
        plant.wait(lambda: abs(gap(browser)) > 0.04)
        browser.do("click", role="button", name="Load turn.yaml")
        browser.do("wait", selector="[aria-label='Patch']", text="turn.yaml is loaded.")
        plant.wait(lambda: abs(gap(browser)) < 0.02)
        browser.do("click", role="button", name="Remove the patch")
        browser.do("wait", selector="[aria-label='Patch']", text="No patch is loaded.")
        plant.wait(lambda: abs(gap(browser)) > 0.04)
    assert browser.do("errors") == []


def gap(browser):
    text = browser.do("text", selector="[data-gap='velocity.angular_rad_s'] dd")
    return float(text.split()[0].replace("\u2212", "-"))
