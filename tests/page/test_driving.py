"""A real browser drives; what counts is what the plant has latched, and at which tick."""

import asyncio
import os
import signal

import pytest
from asyncua import ua

from tests.io.opcua_server.rig import RobotClient
from tests.page.rig import DEADMAN_MS, page_process, page_url, reset

pytestmark = pytest.mark.page
LIMIT_MS = DEADMAN_MS + 2000 / 30
"""The dead-man's time and two frames."""
HITS_STOP = """(() => {
  const box = document.querySelector(".estop").getBoundingClientRect();
  const hit = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
  return !!hit?.closest(".estop") && !document.querySelector(":modal");
})()"""
TRIES = 3
"""A busy computer may hold the daemon up now and then; that is not the dead-man."""


@pytest.fixture
def drive(browser, url, plant):
    """Hold the arrow key until the robot moves; return the browser that does."""

    def begin():
        browser.do("open", url=url)
        browser.do("take")
        browser.do("down", key="ArrowUp")
        plant.wait(lambda: plant.command() > 0.1)
        plant.wait(lambda: plant.value("velocity.linear_m_s") > 0.05)
        return browser

    return begin


@pytest.fixture
def driving(drive):
    return drive()


def ends_in_time(drive, plant, fall_silent, awake=lambda: None):
    """Drive, fall silent, see when the plant stands still; the best of some tries counts."""
    held_ms = []
    for _ in range(TRIES):
        browser = drive()
        fall_silent(browser)
        try:
            plant.wait(lambda: plant.command() == 0.0)
            held_ms.append(plant.silence_ms())
        finally:
            awake()
        browser.do("fresh")
        if held_ms[-1] <= LIMIT_MS:
            break
    print(f"held for {held_ms} ms")
    assert min(held_ms) <= LIMIT_MS


def test_a_held_key_drives_and_letting_go_stops(driving, plant):
    ahead = plant.value("twist.linear_m_s")
    driving.do("down", key="ArrowLeft")
    # left is counter-clockwise
    plant.wait(lambda: plant.value("twist.angular_rad_s") > 0.1)
    assert plant.value("twist.linear_m_s") == pytest.approx(ahead)
    driving.do("up", key="ArrowLeft")
    driving.do("up", key="ArrowUp")
    plant.wait(lambda: plant.command() == 0.0)
    assert driving.do("errors") == []


def test_s_stops_although_the_key_is_held_and_so_does_leaving_the_view(driving, plant):
    driving.do("press", key="s")
    plant.wait(lambda: plant.command() == 0.0)
    driving.do("up", key="ArrowUp")
    driving.do("down", key="ArrowDown")
    plant.wait(lambda: plant.value("twist.linear_m_s") < -0.1)
    driving.do("view", name="Watch")
    plant.wait(lambda: plant.command() == 0.0)


@pytest.mark.parametrize("how", ["mute", "cut", "freeze"])
def test_a_browser_that_falls_silent_is_stopped(drive, plant, how, chromium):
    def thaw():
        if how == "freeze":
            chromium.receive()
            chromium.do("thaw")

    def fall_silent(browser):
        browser.send(how)
        if how != "freeze":
            browser.receive()

    ends_in_time(drive, plant, fall_silent, thaw)


def test_a_browser_that_is_stopped_is_stopped(drive, plant, chromium):
    group = chromium.do("pid")
    ends_in_time(
        drive,
        plant,
        lambda browser: os.killpg(group, signal.SIGSTOP),
        lambda: os.killpg(group, signal.SIGCONT),
    )


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_page_that_fails_is_stopped_and_the_daemon_runs_on(
    drive, plant, daemon, number
):
    page = page_process(daemon)

    def awake():
        if number == signal.SIGSTOP:
            os.kill(page, signal.SIGCONT)

    ends_in_time(drive, plant, lambda browser: os.kill(page, number), awake)
    before = plant.value("sim.tick")
    plant.wait(lambda: plant.value("sim.tick") > before)


def test_the_page_is_there_again_after_it_was_killed(browser, daemon):
    os.kill(page_process(daemon), signal.SIGKILL)
    browser.do("open", url=page_url(daemon))


def test_the_emergency_stop_needs_no_webgl(driving, plant):
    assert driving.do("stage")
    driving.do("click", role="button", name="Stop emergency")
    plant.wait(lambda: plant.value("sim.state") == 3)
    driving.do("up", key="ArrowUp")
    reset(driving, plant)


def test_a_gamepad_drives_while_its_stick_is_held(browser, url, plant):
    browser.do("open", url=url)
    browser.do("take")
    browser.do("run", script="window.pad = {connected: true, axes: [0, 0]}")
    browser.do("looked")
    browser.do("run", script="window.pad = {connected: true, axes: [-0.5, -0.8]}")
    plant.wait(lambda: plant.value("twist.linear_m_s") > 0.1)
    plant.wait(lambda: plant.value("twist.angular_rad_s") > 0.1)
    browser.do("run", script="window.pad = {connected: true, axes: [0.05, -0.05]}")
    plant.wait(lambda: plant.command() == 0.0)


PAD = """window.pad = {connected: true, index: 0, id: "pad", mapping: "standard", axes: %s,
  get timestamp() { return performance.now(); }, buttons: Array.from({length: 18},
  (_, i) => ({pressed: %s.includes(i), value: %s.includes(i) ? 1 : 0}))}"""
CHOICE = """(() => { const pads = [...document.querySelectorAll(".keyboard select")][0];
  pads.value = "%s"; pads.dispatchEvent(new Event("change")); return pads.value; })()"""
TRIANGLE, CIRCLE, R2, TOUCH = 3, 1, 7, 17  # as a browser counts them


def hold(browser, axes, *buttons):
    browser.do("run", script=PAD % (axes, list(buttons), list(buttons)))
    browser.do("looked")


@pytest.mark.parametrize(
    ("mapping", "axes", "idle", "lamp", "stop"),
    [
        ("iotbot-ros2", [-0.5, 0, 0, -0.8], [0, -0.8, -0.5, 0], TOUCH, CIRCLE),
        ("joy_extended", [0, -0.8, -0.5, 0], [-0.5, 0, 0, -0.8], CIRCLE, TRIANGLE),
    ],
)
def test_a_gamepad_is_read_as_on_the_robot(
    browser, url, plant, mapping, axes, idle, lamp, stop
):
    browser.do("open", url=url)
    browser.do("take")
    assert browser.do("run", script=CHOICE % mapping) == mapping
    hold(browser, [0, 0, 0, 0])
    hold(browser, axes)
    plant.wait(lambda: plant.value("twist.linear_m_s") > 0.1)
    plant.wait(lambda: plant.value("twist.angular_rad_s") > 0.1)
    hold(browser, idle)  # the axes of the other generation
    plant.wait(lambda: plant.command() == 0.0)
    if mapping == "joy_extended":
        hold(browser, axes, R2)  # its factor
        assert plant.command() == 0.0
    hold(browser, [0, 0, 0, 0], lamp)
    plant.wait(lambda: plant.value("lights.command") == 3)
    assert plant.value("sim.state") == 1
    hold(browser, [0, 0, 0, 0], stop)
    plant.wait(lambda: plant.value("sim.state") == 3)
    browser.do("run", script="window.pad = null")
    reset(browser, plant)
    assert browser.do("run", script=CHOICE % "page") == "page"


def test_keys_drive_in_every_view_and_a_held_one_does_not_go_on_after_s(
    browser, url, plant
):
    browser.do("open", url=url)
    browser.do("take")
    for view in ("Watch", "Signals", "Time", "Diagnosis"):
        browser.do("view", name=view)
        browser.do("down", key="ArrowUp")
        plant.wait(lambda: plant.value("twist.linear_m_s") > 0.1)
        browser.do("press", key="s")
        browser.do("down", key="ArrowUp")  # what a held key sends again and again
        plant.wait(lambda: plant.command() == 0.0)
        browser.do("up", key="ArrowUp")


@pytest.mark.parametrize("how", ["x", " ", "Escape", "gamepad"])
def test_stop_from_every_view_by_key_and_gamepad(browser, url, plant, how):
    browser.do("open", url=url)
    browser.do("take")
    browser.do("view", name="Watch")
    browser.do("run", script="document.activeElement.blur()")
    if how == "gamepad":
        pad = "{connected: true, axes: [0, 0], buttons: [{}, {pressed: true}]}"
        browser.do("run", script=f"window.pad = {pad}")
    else:
        browser.do("press", key=how)
    plant.wait(lambda: plant.value("sim.state") == 3)
    browser.do("run", script="window.pad = null")
    reset(browser, plant)


def test_a_controller_drives_after_a_stop_by_start_alone(browser, url, plant, daemon):
    source = ("control.source", "opcua", ua.VariantType.String)
    commands = [
        ("control.mode", 1, ua.VariantType.Byte),
        ("twist.linear_m_s", 0.2, ua.VariantType.Double),
    ]
    browser.do("open", url=url)
    with asyncio.Runner() as runner:
        controller = RobotClient(daemon.url)
        runner.run(controller.connect())
        plant.wait(lambda: runner.run(controller.write(source)) == ["Good"])

        browser.do("click", role="button", name="Stop emergency")
        plant.wait(lambda: plant.value("sim.state") == 3)
        browser.do("click", role="button", name="Reset")
        browser.do("wait", selector=".banner", text="Waiting for Start")
        assert "BadInvalidState" in runner.run(controller.write(*commands))
        assert plant.value("twist.linear_m_s") == 0.0

        browser.do("click", role="button", name="Start")
        plant.wait(lambda: plant.value("control.waits_for_start") == 0)
        assert runner.run(controller.write(*commands)) == ["Good"] * 2
        plant.wait(lambda: plant.value("twist.linear_m_s") > 0.1)
        runner.run(controller.disconnect())


def test_a_socket_that_does_not_answer_does_not_keep_stop(browser, url, plant):
    browser.do("open", url=url)
    browser.do("mute")  # what is sent over the socket goes nowhere
    browser.do("click", role="button", name="Stop emergency")
    plant.wait(lambda: plant.value("sim.state") == 3)
    reset(browser, plant)


def test_a_second_browser_asks_before_it_takes_control(driving, url, plant):
    driving.do("second", url=url)
    driving.do("click", role="button", name="Take control")
    driving.do("wait", selector="dialog", text="Take control from another browser?")
    assert driving.do("run", script=HITS_STOP)  # the emergency stop stays in reach
    driving.do("click", role="button", name="Cancel")
    plant.wait(lambda: plant.command() > 0.1)  # a starved browser pauses for a moment
    driving.do("click", role="button", name="Take control")
    driving.do("click", role="button", name="Take over")
    driving.do("wait", selector=".owner", text="You drive")
    driving.do("back")
    driving.do("wait", selector=".control button", text="Take control")
    plant.wait(lambda: plant.command() == 0.0)


def test_a_page_that_was_started_again_is_there_again_by_itself(
    browser, url, plant, daemon
):
    """Before, the open page asked with its old token, and got 401, for ever."""
    browser.do("open", url=url)
    browser.do("run", script="window.same = true")
    os.kill(page_process(daemon), signal.SIGKILL)
    browser.do("wait", selector=".state", text="offline")
    browser.do("wait", selector=".state", text="running")
    assert browser.do("run", script="window.same")
    browser.do("take")
    browser.do("down", key="ArrowUp")
    plant.wait(lambda: plant.command() > 0.1)
    browser.do("up", key="ArrowUp")


def test_single_wheels_spring_back(browser, url, plant):
    browser.do("open", url=url)
    browser.do("take")
    browser.do("click", role="button", name="Single wheels")
    browser.do("run", script="document.querySelector('.wheels input').focus()")
    browser.do("down", key="ArrowRight")
    plant.wait(lambda: plant.value("wheel.fl.setpoint_rpm") > 1)
    assert plant.value("wheel.fr.setpoint_rpm") == 0
    browser.do("up", key="ArrowRight")
    plant.wait(lambda: plant.command() == 0.0)


def test_what_a_twist_asks_of_the_wheels_is_marked_beside_what_they_do(
    browser, url, plant
):
    mark = "document.querySelector('.bars .wanted')"
    shown = f"!{mark}.hidden && parseFloat({mark}.style.transform.slice(11)) > 1"
    browser.do("open", url=url)
    browser.do("take")
    browser.do("down", key="ArrowUp")
    plant.wait(lambda: browser.do("run", script=shown))
    assert plant.value("wheel.fl.setpoint_rpm") == 0.0
    browser.do("up", key="ArrowUp")
    plant.wait(lambda: plant.command() == 0.0)


def test_every_light_pattern_reaches_the_robot(browser, url, plant):
    browser.do("open", url=url)
    browser.do("take")
    lights = "document.querySelector('.lights select')"
    # A test before may have left a pattern: the list shows it as soon as it is known.
    left = str(int(plant.value("lights.command")))
    plant.wait(lambda: browser.do("run", script=f"{lights}.value") == left)
    browser.do("run", script=f"{lights}.focus()")
    browser.do("press", key="Home")
    plant.wait(lambda: plant.value("lights.command") == 0)
    for pattern in (1, 2, 3, 4, 5, 6, 7, 8):
        browser.do("press", key="ArrowDown")
        plant.wait(lambda pattern=pattern: plant.value("lights.command") == pattern)
    browser.do("press", key="Home")
    plant.wait(lambda: plant.value("lights.command") == 0)


def test_who_looks_on_cannot_pause_while_another_browser_drives(driving, url, plant):
    """Before, one press of whoever looked on disturbed who drove, and nobody was told whose."""
    driving.do("second", url=url)
    driving.do("view", name="Time")
    driving.do("click", role="button", name="Pause")
    driving.do("wait", selector="dialog", text="Another browser is driving.")
    driving.do("run", script="document.querySelector('dialog .primary').click()")
    driving.do("wait", selector=".toast", text="drives by the page: take control first")
    assert plant.value("sim.state") == 1
    driving.do("back")
