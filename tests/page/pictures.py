"""``make pictures``: every view of the page, as it stands in the docs, on a computer that is quiet.

A daemon with the body drives its eight in the hall of the example, beside a "real" robot that is
a little off; a diagnosis and a sweep are run and their reports opened. Takes a few minutes. The
browser draws by software and would take all cores: one of them is the plant's alone, and its
figures are reset before each picture. Slices of 2 ms are in time on a virtual machine, too, where a
hypervisor takes a millisecond every few seconds. If the plant is late all the same, no picture is
saved.
"""

import asyncio
import contextlib
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hilserver_injector import Recipe, make

from benchmarks.attack_target import core_for_the_plant
from tests.helpers.daemons import running_daemon
from tests.io.opcua_server.rig import RobotClient
from tests.page.rig import Browser, Plant, diagnoses, lift, page_url

EXAMPLES = Path(__file__).parents[2] / "examples"
CONFIG = """
page: {port: 0}
mechatronic: {enabled: true}
sensors: {tof: {hall: hall.yaml}}
scheduler:
  base_period_ms: 2.0
  slices: {plant: 2.0, mechatronic: 4.0}
  realtime: {priority: PRIORITY, cpu: CPU, lock_memory: false, hold_latency_target: false}
  limits: {single_overrun_ms: null, consecutive_overruns: null}
  communication_timeout_ms: 0
"""
SIZES = {
    "": (1280, 800, "light"),
    "-phone": (390, 844, "light"),
    "-dark": (1280, 800, "dark"),
}
VIEWS = ("Drive", "Watch", "Signals", "Time", "Diagnosis", "Tune")
SAFE = 3
SWEEP = "sweeps/friction"
CLOSER = """const canvas = document.querySelector("canvas");
for (let i = 0; i < 12; i++) canvas.dispatchEvent(
  new WheelEvent("wheel", { deltaY: -100, bubbles: true, cancelable: true }))"""
LATE = "document.querySelector('.figures .why').textContent"
TRIES = 20
HIGH_BEAM = """const select = document.querySelector(".lights select");
select.value = "2"; select.dispatchEvent(new Event("change"))"""
OFF_M, OFF_RAD = 0.45, 0.25


class StarvedError(Exception):
    """The plant was late in every try: the computer had other work."""


async def shadow(url, plant):
    """Say, for ever, that the real robot is a little beside the simulated one."""
    client = RobotClient(url)
    await client.connect()
    while True:
        if (
            plant.value("sim.state") == SAFE
        ):  # where a busy computer holds the controller up
            for method in ("Reset", "Start"):
                await client.call(method)
        x, y, yaw = (plant.value(f"pose.{name}") for name in ("x_m", "y_m", "yaw_rad"))
        real = {
            "x_m": x + OFF_M,
            "y_m": y,
            "yaw_rad": math.remainder(yaw - OFF_RAD, math.tau),
        }
        await client.write_doubles(**{f"measured.pose.{k}": v for k, v in real.items()})
        await asyncio.sleep(0.1)


def prepare(folder):
    """Give the daemon a hall, a log to diagnose, and a sweep."""
    shutil.copy(EXAMPLES / "body" / "hall.yaml", folder)
    for name in ("recordings", "scenarios", "patches"):
        (folder / name).mkdir()
    table, _ = make(Recipe(seed=3, causes={"rotation_gain": 0.15}, duration_s=90.0))
    table.write_csv(folder / "recordings" / "turns.csv")
    words = ["sweep", str(EXAMPLES / "sweep" / "sweep.yaml"), "-o", str(folder / SWEEP)]
    subprocess.run([sys.executable, "-m", "hilserver", *words], check=True)


def diagnose(browser, daemon):
    """Run a diagnosis on the page, and open its report."""
    browser.do("view", name="Diagnosis")
    browser.do("click", role="button", name="Diagnose turns.csv")
    browser.do("wait", selector=".jobs progress")
    while running := diagnoses(daemon):
        lift(running[0])
        time.sleep(1)
    read(browser)
    browser.do("click", role="button", name="Load the patch")
    browser.do("wait", selector="[aria-label='Patch']", text="is loaded.")


def read(browser):
    """Open the report of the diagnosis."""
    browser.do("click", role="button", name="Read the report")
    browser.do("framed", selector="body")


def views(browser, url, out):
    """Take the pictures."""
    for suffix, (width, height, scheme) in SIZES.items():
        browser.do("fresh", width=width, height=height, scheme=scheme)
        browser.do("open", url=url)
        for name in VIEWS:
            browser.do("view", name="Time")
            browser.do("click", role="button", name="Reset timing figures")
            browser.do("view", name=name)
            if name == "Diagnosis":
                read(browser)
            if name == "Drive":
                browser.do("run", script=CLOSER)
            browser.do("rest", ms=12_000 if name in ("Drive", "Watch") else 2_000)
            shot(browser, out / f"{name.lower()}{suffix}.webp")


def shot(browser, path):
    """Take one once the plant has not been late for a while; StarvedError if that never comes."""
    for _ in range(TRIES):
        if not (late := browser.do("run", script=LATE)):
            return browser.do("shot", path=str(path))
        browser.do("rest", ms=3_000)
    raise StarvedError(f"{path.name}: {late}")


def near(browser, url, out):
    """Take one behind the robot, with its lamps on."""
    browser.do("fresh")
    browser.do("open", url=url)
    browser.do("take")
    browser.do("click", role="button", name="Follow")
    browser.do("run", script=HIGH_BEAM)
    browser.do("down", key="ArrowUp")
    browser.do("rest", ms=3_000)
    shot(browser, out / "follow.webp")
    browser.do("up", key="ArrowUp")


def sweep(browser, url, out):
    """Take one of the report of a sweep."""
    browser.do("fresh")
    browser.do("open", url=url)
    browser.do("view", name="Diagnosis")
    browser.do("click", role="button", name=f"Read the report of {Path(SWEEP).name}")
    browser.do("framed", selector="h1")
    shot(browser, out / "sweep.webp")


async def take(out):
    """Take all pictures into a folder."""
    cpu = core_for_the_plant()
    config = CONFIG.replace("PRIORITY", "60" if os.geteuid() == 0 else "0")
    config = config.replace("CPU", "null" if cpu is None else str(cpu))
    with (
        tempfile.TemporaryDirectory(prefix="hilserver-") as folder,
        running_daemon(
            Path(folder), "--demo", config=config, ring_frames=1 << 14, prepare=prepare
        ) as daemon,
        contextlib.closing(Browser(webgl=True)) as browser,
    ):
        url, beside = (
            page_url(daemon),
            asyncio.create_task(shadow(daemon.url, Plant(daemon.image))),
        )
        browser.do("fresh")
        await asyncio.to_thread(browser.do, "open", url=url)
        await asyncio.to_thread(diagnose, browser, daemon)
        await asyncio.to_thread(views, browser, url, out)
        await asyncio.to_thread(near, browser, url, out)
        await asyncio.to_thread(sweep, browser, url, out)
        beside.cancel()


def main(target):
    """Take all pictures, and save them once all are taken."""
    with tempfile.TemporaryDirectory(prefix="hilserver-") as name:
        out = Path(name)
        try:
            asyncio.run(take(out))
        except StarvedError as error:
            sys.exit(
                f"no picture is saved, the plant was late all the time: {error}; close what"
                " else runs on this computer and try again"
            )
        target.mkdir(parents=True, exist_ok=True)
        for path in out.iterdir():
            shutil.copy(path, target)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
