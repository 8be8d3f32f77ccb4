"""Drive a running daemon from the terminal: hold a key to drive, release it to stop.

Arrows or W and S drive forward and backward, A and D turn, Q and E go sideways (mecanum), space
stops, + and - change the speed, 0 to 8 set the lights, X or Ctrl-C ends. A terminal with the kitty
keyboard protocol reports releases; with any other, a first press drives for at most 700 ms, and
then 150 ms without a repeat stop. Whatever happens to this program, the daemon stops the robot
when no fresh command comes for page.deadman_ms.
"""

import argparse
import asyncio
import codecs
import contextlib
import getpass
import os
import shutil
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from hilserver.commands.options import number
from hilserver.commands.remote import add_connection, configured
from hilserver.commands.teleop_keys import ASK, END, Hold, Key, KeyReader, Word
from hilserver.errors import EXIT_DONE, EXIT_FAILED, FailedError
from hilserver.io.page.hand import Hand, RefusedError
from hilserver.io.page.setup import OpcUaAccess
from hilserver.program import event_loop
from hilserver.signals import LIGHTS, Ranges, State, robot_table
from hilserver.tasks import first_of
from hilserver.time_limit import time_limit

EXAMPLE = "hilserver teleop --endpoint opc.tcp://127.0.0.1:4840/hilserver"

SESSION: Final = "teleop"
RENEW_S: Final = 0.05
SHOW_S: Final = 0.1
STEP: Final = 1.1
AXES: Final[dict[str, tuple[str, float]]] = {
    "up": ("linear", 1.0),
    "w": ("linear", 1.0),
    "down": ("linear", -1.0),
    "s": ("linear", -1.0),
    "left": ("turn", 1.0),
    "a": ("turn", 1.0),
    "right": ("turn", -1.0),
    "d": ("turn", -1.0),
    "q": ("lateral", 1.0),
    "e": ("lateral", -1.0),
}
SET: Final = {
    "linear": "twist.linear_m_s",
    "turn": "twist.angular_rad_s",
    "lateral": "twist.lateral_m_s",
}
"""Set-point by axis."""
SHOWN: Final = (
    "velocity.linear_m_s",
    "velocity.angular_rad_s",
    "sim.tick",
    "sim.state",
    "control.source",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_connection(parser)
    parser.add_argument(
        "--via",
        choices=["opcua"],
        default="opcua",
        help="connection to the robot; default: opcua",
    )
    parser.add_argument(
        "--speed",
        type=number(1e-3, 1e3, "speed"),
        default=0.3,
        metavar="M_S",
        help="forward [m/s]; default: 0.3",
    )
    parser.add_argument(
        "--turn",
        type=number(1e-3, 1e3, "speed"),
        default=0.8,
        metavar="RAD_S",
        help="turn rate [rad/s]; default: 0.8",
    )


def run(args: argparse.Namespace) -> int:
    """Drive until the user ends it; return 0, or 1 if the daemon is lost."""
    if not sys.stdin.isatty():
        raise FailedError("teleop reads keys from a terminal; start it in one")
    endpoint = args.endpoint or configured(args)
    password = getpass.getpass() if args.user else ""
    return event_loop.run(_drive(args, endpoint, password))


async def _drive(args: argparse.Namespace, endpoint: str, password: str) -> int:
    table = robot_table(Ranges(1.0, 1.0, 1.0))
    types = {s.name: s.type.value for s in table}
    hand = Hand(OpcUaAccess(endpoint, SESSION), types)
    asked = event_loop.end_event()
    with event_loop.hang_ups() as hung_up:
        try:
            await hand.connect(args.user, password)
            await hand.write({"control.source": "opcua"})
            ranges = await hand.read([f"{name}.EURange" for name in SET.values()])
        except RefusedError as error:
            await hand.close()
            raise FailedError(f"{endpoint}: {error}") from None
        fastest = {
            axis: found.High
            for axis, found in zip(SET, ranges, strict=True)
            if found is not None
        }
        driver = KeyDriver(hand, args.speed, args.turn, fastest)
        try:
            with _keys(driver.take):
                ends = [event.wait() for event in (asked, hung_up, driver.ended)]
                await first_of(driver.run(), *ends)
        finally:
            with contextlib.suppress(RefusedError):
                await hand.write(driver.command(frozenset()))
            await hand.close()
    if driver.complaint_ends:
        print(f"hilserver: {driver.complaint_ends}", file=sys.stderr)
        return EXIT_FAILED
    return EXIT_DONE


class KeyDriver:
    """Turns held keys into commands that are renewed as long as they are held."""

    def __init__(
        self,
        hand: Hand,
        speed_m_s: float,
        turn_rad_s: float,
        fastest: Mapping[str, float],
    ) -> None:
        self.ended = asyncio.Event()  # the user wants to end
        self.complaint_ends = ""  # why driving ended by itself
        self._hand = hand
        self._hold = Hold()
        self._reader = KeyReader()
        self._fastest = fastest  # by axis; 0: it cannot go that way, as it will say
        self._sizes = self._possible(
            {"linear": speed_m_s, "turn": turn_rad_s, "lateral": speed_m_s}
        )
        self._news = asyncio.Event()
        self._lights: int | None = None
        self._complaint = self._said = ""
        self._seen: list[Any] = [None] * len(SHOWN)
        self._fresh_s = time.monotonic()
        self._show_at_s = 0.0

    def take(self, text: str) -> None:
        """Take what the terminal sent; an empty text means that it is closed."""
        if not text:
            self.ended.set()
        for event in self._reader.feed(text):
            if event is Word.HAS_RELEASES:
                self._hold.has_releases = True
            elif event is Word.LOST_FOCUS:
                self._hold.release_all()
            elif isinstance(event, Key):
                if not event.is_down:
                    self._hold.release(event.name)
                elif event.name in ("ctrl-c", "x"):
                    self.ended.set()
                elif event.name == " ":
                    self._hold.release_all()
                elif event.name in ("+", "-"):
                    factor = STEP if event.name == "+" else 1 / STEP
                    wanted = {axis: size * factor for axis, size in self._sizes.items()}
                    self._sizes = self._possible(wanted)
                elif event.name.isdigit() and int(event.name) < len(LIGHTS):
                    self._lights = int(event.name)
                elif event.name in AXES:
                    self._hold.press(event.name, time.monotonic())
        self._news.set()

    def _possible(self, sizes: Mapping[str, float]) -> dict[str, float]:
        """Return speeds that the robot accepts: one that is too fast would move nothing."""
        return {
            axis: min(size, self._fastest.get(axis) or size)
            for axis, size in sizes.items()
        }

    def command(self, held: frozenset[str]) -> dict[str, Any]:
        """Return the set-points for the held keys."""
        sums = dict.fromkeys(self._sizes, 0.0)
        for key in held:
            axis, sign = AXES[key]
            sums[axis] += sign * self._sizes[axis]
        values: dict[str, Any] = {
            "control.mode": 1,
            **{name: sums[axis] for axis, name in SET.items()},
        }
        return {"drive.enable": True, **values} if any(sums.values()) else values

    async def run(self) -> None:
        """Drive until the daemon is lost."""
        was_held: frozenset[str] = frozenset()
        while True:
            held = self._hold.held(time.monotonic())
            try:
                if (
                    held and not was_held
                ):  # after a Reset the daemon waits for keys at rest
                    await self._write(self.command(frozenset()))
                if held or was_held:
                    await self._write(self.command(held))
                if self._lights is not None:
                    lights = self._lights
                    self._lights = None
                    colour = dict.fromkeys(
                        ("lights.red", "lights.green", "lights.blue"), 255
                    )
                    await self._write({"lights.command": lights, **colour})
                await self._look()
            except ConnectionError as error:
                self.complaint_ends = str(error)
                return
            was_held = held
            # A key, the end of a hold or the next renewal.
            now_s = time.monotonic()
            end_s = self._hold.next_end_s()
            rest_s = RENEW_S if held else SHOW_S
            if end_s is not None:
                rest_s = min(rest_s, max(end_s - now_s, 0.001))
            with contextlib.suppress(TimeoutError):
                async with time_limit(rest_s):
                    await self._news.wait()
            self._news.clear()

    async def _write(self, values: dict[str, Any]) -> None:
        """Write, and show what is refused; a lost daemon raises ConnectionError."""
        try:
            await self._hand.write(values)
            self._complaint = ""
        except RefusedError as error:
            if not self._hand.is_connected:
                raise ConnectionError(str(error)) from None
            self._complaint = str(error)

    async def _look(self) -> None:
        if time.monotonic() < self._show_at_s:
            return
        self._show_at_s = time.monotonic() + SHOW_S
        try:
            seen = await self._hand.read(SHOWN)
        except RefusedError as error:
            raise ConnectionError(str(error)) from None
        if seen[2] != self._seen[2]:
            self._fresh_s = time.monotonic()
        self._seen = seen
        if self._said != self._hold.words:
            self._said = self._hold.words
            sys.stdout.write(f"\r\x1b[Kthe hold ends {self._said}\n")
        width = shutil.get_terminal_size().columns - 1
        linear, angular, _, state, source = self._seen
        age_ms = (time.monotonic() - self._fresh_s) * 1e3
        line = self._complaint or (
            f"{linear or 0.0:+.2f} m/s {angular or 0.0:+.2f} rad/s | age {age_ms:.0f} ms"
            f" | {State(state or 0).word} | control: {source}"
        )
        sys.stdout.write(f"\r\x1b[K{line[:width]}")
        sys.stdout.flush()


@contextlib.contextmanager
def _keys(take: Callable[[str], None]) -> Iterator[None]:
    """Hand every key to `take` as it is pressed; leave the terminal as it was."""
    loop, file = asyncio.get_running_loop(), sys.stdin.fileno()
    decoder = codecs.getincrementaldecoder("utf-8")("replace")

    def read() -> None:
        try:
            data = os.read(file, 1024)
        except OSError:  # the terminal is gone
            data = b""
        if not data:
            loop.remove_reader(file)
        take(decoder.decode(data) if data else "")

    before = termios.tcgetattr(file)
    tty.setcbreak(file)
    sys.stdout.write(f"{ASK}hold arrows or WASD to drive, space stops, X ends\n")
    sys.stdout.flush()
    loop.add_reader(file, read)
    try:
        yield
    finally:
        loop.remove_reader(file)
        with contextlib.suppress(OSError, termios.error):
            sys.stdout.write(f"{END}\n")
            sys.stdout.flush()
            termios.tcsetattr(file, termios.TCSADRAIN, before)
