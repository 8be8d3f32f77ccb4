"""What the screen owes whoever operates: what runs, how it ended, when, and on every screen."""

import contextlib
import os
import re
import signal
import subprocess

import pytest

from tests.page.test_views import _STRETCHES, becomes

pytestmark = pytest.mark.page
ALARM = ".alarm p"


def recorders(daemon):
    """The processes of the recordings that were started on the page."""
    words = ["pgrep", "-P", str(daemon.process.pid), "-f", "record --image"]
    found = subprocess.run(words, check=False, capture_output=True, text=True)
    return [int(pid) for pid in found.stdout.split()]


def number(browser, script):
    """A number that the page shows."""
    return float(re.search(r"-?[\d.]+", browser.do("run", script=script))[0])


def test_a_recording_is_seen_in_every_view_and_its_end_stays(
    browser, url, plant, daemon
):
    """Before, one that died was silent, whichever way."""
    browser.do("open", url=url)
    browser.do("view", name="Time")
    browser.do("fill", label="Name of the recording", text="drive.xyz")
    browser.do("click", role="button", name="Record")
    browser.do("wait", selector=".toast", text="'drive.xyz' does not end in .mcap")
    browser.do("fill", label="Name of the recording", text="doomed.mcap")
    browser.do("click", role="button", name="Record")
    browser.do("view", name="Signals")
    browser.do("wait", selector=".work a", text="Recording doomed.mcap")
    seen = []
    plant.wait(lambda: seen.append(recorders(daemon)) or seen[-1])
    (recorder,) = seen[-1]
    plant.wait((daemon.folder / "recordings" / "doomed.mcap").exists)
    os.kill(recorder, signal.SIGKILL)
    browser.do("wait", selector=ALARM, text="the recorder was ended by SIGKILL")
    gone = "document.querySelector('.work').hidden"
    becomes(browser, gone, "true")
    browser.do("open", url=url)
    browser.do("wait", selector=ALARM, text="the recorder was ended by SIGKILL")
    browser.do("click", role="button", name="Understood")
    browser.do("open", url=url)
    browser.do("view", name="Time")
    browser.do("wait", selector=".events .severe", text="ended by SIGKILL")
    assert browser.do("run", script="document.querySelectorAll('.alarm').length") == 0
    assert browser.do("errors") == []


def test_an_event_is_found_in_the_plots_which_keep_what_came_in_meanwhile(browser, url):
    browser.do("open", url=url)
    browser.do("view", name="Watch")
    browser.do("click", role="button", name="Pause")
    browser.do("to", name="Cursor")
    browser.do("press", key="Home")
    begin = number(browser, "document.querySelector('.moment').textContent")
    browser.do("view", name="Time")
    browser.do("click", role="button", name="Pause")
    browser.do("wait", selector=".state", text="paused")
    event = """[...document.querySelectorAll(".events li")].find((item) =>
        item.innerText.includes("paused")).querySelector(".when")"""
    at = number(browser, f"{event}.querySelector('small').textContent")
    clock = browser.do("run", script=f"{event}.querySelector('time').textContent")
    assert re.fullmatch(r"\d\d:\d\d:\d\d", clock)
    browser.do("click", role="button", name="Resume")
    browser.do("wait", selector=".state", text="running")
    browser.do("run", script=f"{event}.click()")
    browser.do("wait", selector="main[data-view='watch'] .then:not(:empty)")
    shown = browser.do("text", selector=".moment")
    assert float(shown.split()[0]) == pytest.approx(at, abs=0.5)
    assert re.search(r", \d\d:\d\d:\d\d$", shown)
    browser.do("to", name="Cursor")
    browser.do("press", key="Home")
    moment = "parseFloat(document.querySelector('.moment').textContent)"
    becomes(browser, f"{moment} <= {begin}", "true")  # nothing has gone
    assert browser.do("errors") == []


def test_the_wheel_zooms_all_plots_and_one_signal_is_drawn_over_another(browser, url):
    browser.do("open", url=url)
    browser.do("view", name="Watch")
    becomes(
        browser, "/[0-9]/.test(document.querySelector('.legend b').textContent)", "true"
    )
    browser.do("wheel", selector=".plot .u-over", at=0.8, dy=-500)
    browser.do("wait", selector="button", text="Resume")
    (low, high), other = browser.do("run", script=_STRETCHES)
    assert 1 < high - low < 15  # of 20 s
    assert other == [low, high]
    browser.do("run", script="document.querySelectorAll('.turn')[1].click()")
    name = "document.querySelectorAll('.plot')[1].ariaLabel"
    turned = "velocity.angular_rad_s over velocity.linear_m_s"
    assert turned in browser.do("run", script=name)
    browser.do("open", url=url)
    browser.do("view", name="Watch")
    becomes(browser, f"{name}?.includes('{turned}')", "true")
    assert browser.do("errors") == []


def test_a_snapshot_is_replaced_only_after_a_question(browser, url, daemon):
    browser.do("open", url=url)
    browser.do("view", name="Time")
    for answer in ("", "Cancel", "Replace"):
        browser.do("fill", label="Name of the snapshot", text="asked")
        browser.do("click", role="button", name="Save")
        if answer:
            browser.do("wait", selector="dialog", text="There is a snapshot asked.")
            browser.do("click", role="button", name=answer)
        field = "document.querySelector('[aria-label=\"Name of the snapshot\"]').value"
        if answer != "Cancel":
            becomes(browser, field, "'asked1'")
    saved = [path.name for path in daemon.folder.rglob("asked*.npz")]
    assert saved == ["asked.npz"]
    offered = "document.querySelector('[aria-label=\"Name of the recording\"]').value"
    assert re.fullmatch(
        r"run-\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ\.mcap", browser.do("run", script=offered)
    )


_OVERLAPS = """(() => {
    const rows = [...document.querySelectorAll("[aria-label=Logs] .list li")];
    const boxes = rows.map((row) => row.getBoundingClientRect());
    const inner = rows.flatMap((row, i) => [...row.children].filter((child) =>
        child.getBoundingClientRect().bottom > boxes[i].bottom + 1));
    return [rows.length, inner.length];
})()"""


def test_on_a_phone_who_drives_is_read_and_rows_of_logs_stand_apart(
    browser, url, daemon
):
    folder = daemon.folder / "recordings"
    folder.mkdir(exist_ok=True)
    logs = [folder / f"a-log-with-a-long-name-{i:02d}.csv" for i in range(12)]
    for log in logs:
        log.write_text("t_s,x\n0,1\n1,2\n", encoding="utf-8")
    try:
        browser.do("fresh", width=390, height=844)
        browser.do("open", url=url)
        browser.do("wait", selector=".owner[role=status]", text="drives")
        width = "document.querySelector('.owner').getBoundingClientRect().width"
        assert browser.do("run", script=width) > 100
        browser.do("view", name="Diagnosis")
        browser.do("wait", selector=".list code", text=logs[0].name)
        rows, outside = browser.do("run", script=_OVERLAPS)
        assert (rows >= len(logs), outside) == (True, 0)
    finally:
        for log in logs:
            with contextlib.suppress(OSError):
                log.unlink()


def test_at_200_percent_the_stick_is_above_the_fold(browser, url):
    browser.do("fresh", width=640, height=400)  # of 1280 by 800
    browser.do("open", url=url)
    below = """document.querySelector(".rail").getBoundingClientRect().top -
        document.querySelector(".stick").getBoundingClientRect().bottom"""
    assert browser.do("run", script=below) >= 0


def test_in_the_systems_own_colours_stop_has_its_border_and_sliders_their_shape(
    browser, url
):
    browser.do("fresh", forced=True)
    browser.do("open", url=url)
    border = (
        "parseFloat(getComputedStyle(document.querySelector('.estop')).borderTopWidth)"
    )
    assert browser.do("run", script=border) >= 2
    bars = """[...document.querySelectorAll(".actual, .knob")].map((e) =>
        getComputedStyle(e).backgroundColor).every((c) => c !== "rgba(0, 0, 0, 0)")"""
    assert browser.do("run", script=bars)
