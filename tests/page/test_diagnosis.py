"""Choose a log, follow the diagnosis, read its report, load the patch: the live gap falls."""

import asyncio
import os
import re

import pytest
import yaml
from asyncua import ua
from hilserver_injector import Recipe, make

from tests.io.opcua_server.rig import RobotClient
from tests.page.rig import diagnoses, lift

pytestmark = pytest.mark.page
GAIN = 0.15
TURN_RAD_S = 0.3
LARGE_RAD_S, SMALL_RAD_S = 0.03, 0.015
"""Without the patch 0.045 are missing, with it none."""
LONG_S = 400


async def write(url, *values):
    """Write values as an OPC UA client that drives, until it leaves."""
    client = RobotClient(url)
    await client.connect()
    for method in ("Reset", "Start"):  # whatever was done before
        await client.call(method)
    control = ("control.source", "opcua", ua.VariantType.String)
    async with asyncio.timeout(120):
        while await client.write(control) != ["Good"]:  # noqa: ASYNC110
            await asyncio.sleep(0.1)
    for value in values:
        assert await client.write(value) == ["Good"], value
    return client


@pytest.fixture
def turning(browser, url, daemon):
    """The simulation is asked to turn, and the real robot turns 15 % more."""
    # a page that drove before outranks OPC UA until it gives back
    browser.do("open", url=url)
    browser.do("click", role="button", name="Take control")
    browser.do("click", role="button", name="Give back")
    double = ua.VariantType.Double
    mode = ("control.mode", 1, ua.VariantType.Byte)
    turn = ("twist.angular_rad_s", TURN_RAD_S, double)
    measured = ("measured.velocity.angular_rad_s", TURN_RAD_S * (1 + GAIN), double)
    with asyncio.Runner() as runner:
        client = runner.run(write(daemon.url, mode, turn, measured))
        yield
        runner.run(client.disconnect())  # whoever leaves drives no more


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
    return lambda: diagnoses(daemon)


def begin(browser, url, plant, worker):
    browser.do("open", url=url)
    browser.do("view", name="Diagnosis")
    browser.do("click", role="button", name="Diagnose turns.csv")
    seen = []
    plant.wait(lambda: len(seen.append(worker()) or seen[-1]) == 1)
    (pid,) = seen[-1]
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
    assert re.search(r"turns 1\d\s% more", browser.do("framed", selector="body"))
    browser.do("click", role="button", name="Load the patch")
    browser.do("wait", selector="[aria-label='Patch']", text="is loaded.")
    browser.do("click", role="button", name="Remove the patch")
    browser.do("wait", selector="[aria-label='Patch']", text="No patch is loaded.")
    assert browser.do("errors") == []


def test_with_the_patch_the_live_gap_falls(browser, url, plant, daemon, turning):
    made = {"findings_sha256": "", "config_sha256": "", "version": "1"}
    terms = {"rotation_gain": {"value": GAIN, "unit": "1"}}
    patch = {"schema": "hilserver.model_patch/1", "made_from": made, "terms": terms}
    folder = daemon.folder / "patches"
    folder.mkdir(exist_ok=True)
    (folder / "turn.yaml").write_text(yaml.safe_dump(patch), encoding="utf-8")
    browser.do("open", url=url)
    browser.do("view", name="Diagnosis")
    browser.do("wait", selector="[data-gap]", text="velocity.angular_rad_s")
    plant.wait(lambda: LARGE_RAD_S < gap(browser) < TURN_RAD_S)
    browser.do("click", role="button", name="Load turn.yaml")
    browser.do("wait", selector="[aria-label='Patch']", text="turn.yaml is loaded.")
    browser.do(
        "wait", selector=".misfit", text="turn.yaml was fitted to another configuration"
    )
    plant.wait(lambda: abs(gap(browser)) < SMALL_RAD_S)
    browser.do("click", role="button", name="Remove the patch")
    browser.do("wait", selector="[aria-label='Patch']", text="No patch is loaded.")
    plant.wait(lambda: LARGE_RAD_S < gap(browser) < TURN_RAD_S)
    assert browser.do("errors") == []


def gap(browser):
    text = browser.do("text", selector="[data-gap='velocity.angular_rad_s'] dd")
    return float(text.split()[0].replace("\u2212", "-"))
