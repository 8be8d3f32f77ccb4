"""Teleoperation: keys, holds, and a real terminal in front of a running daemon."""

import asyncio
import contextlib
import fcntl
import os
import signal
import subprocess
import sys
import termios

import pytest
import pytest_asyncio
from hypothesis import given
from hypothesis import strategies as st

from hilserver.commands.teleop import KeyDriver
from hilserver.commands.teleop_keys import FIRST_S, REPEAT_S, Hold, Key, KeyReader, Word
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon

WAIT_S = 150.0
SPEED = "velocity.linear_m_s"

# --- keys -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("w", [Key("w")]),
        ("W ", [Key("w"), Key(" ")]),
        ("\x1b[A\x1bOD", [Key("up"), Key("left")]),
        (
            "\x1b[119;1:1u\x1b[119;1:2u\x1b[119;1:3u",
            [Key("w"), Key("w"), Key("w", False)],
        ),
        ("\x1b[119u", [Key("w")]),
        ("\x1b[1;1:3B", [Key("down", False)]),
        ("\x1b[99;5u\x03", [Key("ctrl-c"), Key("ctrl-c")]),
        ("\x1b[?11u", [Word.HAS_RELEASES]),
        ("\x1b[?0u", []),
        ("\x1b[O\x1b[I", [Word.LOST_FOCUS]),
        ("\x1b[?62;c\x1b[57441;1:1u", []),
    ],
)
def test_what_a_terminal_sends(text, found):
    assert list(KeyReader().feed(text)) == found
    reader = KeyReader()
    assert [event for character in text for event in reader.feed(character)] == found


@given(st.text(max_size=60))
def test_any_text_leaves_the_reader_in_step(text):
    reader = KeyReader()
    list(reader.feed(text))
    list(reader.feed("zz" * 40))
    assert list(reader.feed("w"))[-1:] == [Key("w")]


# --- holds ----------------------------------------------------------------------------------------


def test_a_press_without_repeats_ends_by_itself():
    hold = Hold()
    hold.press("w", 10.0)
    assert hold.held(10.0 + FIRST_S - 0.01) == {"w"}
    assert hold.next_end_s() == 10.0 + FIRST_S
    assert hold.held(10.0 + FIRST_S) == frozenset()


def test_repeats_shorten_the_wait():
    hold = Hold()
    for i in range(10):
        hold.press("w", 10.0 + 0.5 * (i > 0) + 0.03 * i)
    last_s = 10.0 + 0.5 + 0.03 * 9
    assert hold.held(last_s + REPEAT_S - 0.01) == {"w"}
    assert hold.held(last_s + REPEAT_S) == frozenset()


def test_with_releases_only_a_release_ends_a_hold():
    hold = Hold()
    hold.has_releases = True
    hold.press("w", 0.0)
    hold.press("a", 1.0)
    assert hold.held(100.0) == {"w", "a"}
    assert hold.next_end_s() is None
    hold.release("w")
    assert hold.held(100.0) == {"a"}
    hold.release_all()
    assert hold.held(100.0) == frozenset()


# --- a terminal -----------------------------------------------------------------------------------


class Terminal:
    """A pseudo-terminal with the teleoperation of a running daemon in it."""

    def __init__(self, daemon, master, process):
        self.daemon, self.process, self._master = daemon, process, master
        self.shown = ""
        os.set_blocking(master, False)

    def read(self, name):
        return float(self.daemon.image.latest().values[self.daemon.table.slot(name)])

    def type(self, text):
        os.write(self._master, text.encode())

    def look(self):
        with contextlib.suppress(BlockingIOError, OSError):
            self.shown += os.read(self._master, 65536).decode(errors="replace")
        return self.shown

    async def until(self, condition, what):
        try:
            async with asyncio.timeout(WAIT_S):
                while not condition():
                    self.look()
                    await asyncio.sleep(0.01)
        except TimeoutError:
            pytest.fail(
                f"not within {WAIT_S:g} s: {what}; it shows {self.shown[-200:]!r}"
            )

    async def held_by_repeats(self, condition):
        """Press w as a keyboard repeats it until a condition is met."""
        self.type("w")
        await asyncio.sleep(0.5)  # a terminal's delay before it repeats
        async with asyncio.timeout(WAIT_S):
            while not condition():
                self.type("w")
                await asyncio.sleep(0.03)

    async def drives(self):
        await self.until(lambda: self.read(SPEED) > 0.2, "it drives")

    async def stops(self):
        await self.until(lambda: abs(self.read(SPEED)) < 0.01, "it stops")

    def close(self):
        if self._master >= 0:
            os.close(self._master)
        self._master = -1


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def daemon(tmp_path_factory):
    config = Config.model_validate(
        {
            "image": {"name": "auto"},
            "opcua": {"endpoint": "opc.tcp://127.0.0.1:0/hilserver"},
            "metrics": {"enabled": False},
            "page": {"enabled": False, "deadman_ms": 3000},
            "scheduler": {
                "limits": {"single_overrun_ms": None, "consecutive_overruns": None},
                "realtime": {
                    "priority": 0,
                    "lock_memory": False,
                    "hold_latency_target": False,
                },
                "communication_timeout_ms": 0,
            },
        }
    )
    folder = tmp_path_factory.mktemp("teleop")
    async with Daemon(assemble_config(config, folder)) as daemon:
        yield daemon


@pytest_asyncio.fixture(loop_scope="module")
async def terminal(daemon):
    master, slave = os.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, b"\x18\x00\xc8\x00\x00\x00\x00\x00")
    command = [
        sys.executable,
        "-m",
        "hilserver",
        "teleop",
        "--endpoint",
        daemon.part("opcua").url,
    ]
    process = subprocess.Popen(  # noqa: ASYNC220 - returns at once
        command,
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509
    )
    os.close(slave)
    terminal = Terminal(daemon, master, process)
    try:
        await terminal.until(
            lambda: "control: opcua" in terminal.look(), "it shows the robot"
        )
        yield terminal
    finally:
        terminal.close()
        process.kill()
        process.wait()
        await terminal.stops()


in_terminal = pytest.mark.asyncio(loop_scope="module")


@in_terminal
async def test_holding_by_repeats_drives_and_letting_go_stops(terminal):
    assert "the hold ends after 150 ms without a repeat" in terminal.look()
    await terminal.held_by_repeats(lambda: terminal.read(SPEED) > 0.2)
    await terminal.stops()
    assert "age" in terminal.look()


@in_terminal
async def test_one_press_stops_by_itself(terminal):
    x = terminal.read("pose.x_m")
    terminal.type("\x1b[A")
    await terminal.until(lambda: terminal.read("pose.x_m") > x + 0.02, "it drives")
    await terminal.stops()


@in_terminal
async def test_with_the_kitty_protocol_a_hold_lasts_until_its_release(terminal):
    assert "\x1b[?u" in terminal.look()
    terminal.type("\x1b[?11u")
    await terminal.until(
        lambda: "the hold ends when the key is released" in terminal.look(),
        "it says so",
    )
    terminal.type("\x1b[119;1:1u")
    await terminal.drives()
    await asyncio.sleep(1.5)
    assert terminal.read("twist.linear_m_s") == pytest.approx(0.3)
    terminal.type("\x1b[119;1:3u")
    await terminal.stops()
    terminal.type("\x1b[119;1:1u")
    await terminal.drives()
    terminal.type("\x1b[O")  # the window lost the focus: no release would come
    await terminal.stops()


@in_terminal
async def test_closing_the_terminal_stops(terminal):
    terminal.type("\x1b[?11u\x1b[119;1:1u")
    await terminal.drives()
    terminal.close()
    await terminal.stops()
    assert await asyncio.to_thread(terminal.process.wait, WAIT_S) == 0


@in_terminal
async def test_the_daemon_stops_what_a_killed_teleoperation_held(terminal):
    terminal.type("\x1b[?11u\x1b[119;1:1u")
    await terminal.drives()
    terminal.process.send_signal(signal.SIGKILL)
    await terminal.stops()


@in_terminal
async def test_lights_and_the_end(terminal):
    terminal.type("3")
    await terminal.until(lambda: terminal.read("lights.state") == 3, "flash all")
    terminal.type("x")
    assert await asyncio.to_thread(terminal.process.wait, WAIT_S) == 0


@in_terminal
@pytest.mark.long
@pytest.mark.parametrize("protocol", ["kitty", "repeats"])
async def test_letting_go_is_at_the_plant_within_200_ms(terminal, protocol):
    """From the release, or the last repeat of a key, to the first tick that has the zero."""
    if protocol == "kitty":
        terminal.type("\x1b[?11u")
    image, slot = terminal.daemon.image, terminal.daemon.table.slot("twist.linear_m_s")
    took_ms = []
    for _ in range(20):
        if protocol == "kitty":
            terminal.type("\x1b[119;1:1u")
            await terminal.drives()
            terminal.type("\x1b[119;1:3u")
        else:
            await terminal.held_by_repeats(lambda: terminal.read(SPEED) > 0.2)
            terminal.type("w")
        begin, tick = image.head, image.latest().tick
        await terminal.until(
            lambda: terminal.read("twist.linear_m_s") == 0.0, "the zero comes"
        )
        frames = (image.frame(number) for number in range(begin, image.head))
        zero = next(
            frame.tick for frame in frames if frame and frame.values[slot] == 0.0
        )
        took_ms.append((zero - tick) * terminal.daemon.assembly.base_period_ns * 1e-6)
        await terminal.stops()
    print(f"{protocol}: release to plant {sorted(took_ms)} ms")
    assert sorted(took_ms)[10] <= 200.0


def test_the_speed_at_the_start_is_one_that_the_robot_can_go():
    fastest = {"linear": 0.2, "turn": 2.0, "lateral": 0.0}
    driver = KeyDriver(None, 0.3, 0.8, fastest)
    assert driver.command(frozenset({"up"}))["twist.linear_m_s"] == 0.2
    driver.take("+" * 40)
    moving = driver.command(frozenset({"up", "left"}))
    assert (moving["twist.linear_m_s"], moving["twist.angular_rad_s"]) == (0.2, 2.0)
    driver.take("-")
    assert driver.command(frozenset({"up"}))["twist.linear_m_s"] < 0.2
