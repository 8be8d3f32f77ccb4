"""Commissioning: the controller turns each wheel alone, and the wiring shows itself.

The controller (or whoever stands beside it) is asked to turn one wheel after the other, forward,
at a known speed. What arrives is compared: which wheel (side, order), which direction (sign), how
fast (unit). Then the link is cut while the last wheel turns, and the time until the inputs count as
stale is measured. One table, exit code 0 when everything fits, 1 otherwise.
"""

import argparse
import asyncio
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

from hilserver.commands.demo import demo_assembly, running_controller
from hilserver.commands.options import add_config, config_path
from hilserver.daemon.assembly import Assembly, assemble
from hilserver.daemon.daemon import Daemon
from hilserver.errors import EXIT_DONE, EXIT_FAILED, ConfigError
from hilserver.monitoring.logging_setup import setup_logging
from hilserver.plant.layout import WHEEL_WORDS, WHEELS
from hilserver.program import event_loop
from hilserver.status import UNCERTAIN_LAST_USABLE_VALUE

EXAMPLE = "hilserver wiring --demo"
MOVES_RPM = 0.05
SETTLE_S = 0.4
# for a controller whose command never keeps still
SETTLED_AT_MOST_S = 5.0
# a controller that loses the pose for a moment stops, then resumes the same wheel
STOOD_S = 0.4
LOOK_S = 0.005
LATE_LOOK_S = 0.02
UNIT_TOLERANCE = 0.05
STALE_TOLERANCE_MS = 150.0
FACTORS = {
    0.10472: "rad/s instead of rpm",
    9.5493: "the factor 60/(2 pi) is applied twice",
    1 / 60: "1/s instead of rpm",
    6.0: "degrees per second instead of rpm",
    100.0: "0.01 rpm instead of rpm",
    0.01: "rpm divided by 100",
    89.0: "the motor's speed, before the gear",
    1 / 89: "divided by the gear ratio once too often",
}
"""What a wrong factor of a speed usually means."""


@dataclass(frozen=True)
class WheelFinding:
    """One line of the table; `complaint` is empty if all is well."""

    what: str
    arrived: str
    wanted: str
    complaint: str

    @property
    def cells(self) -> tuple[str, ...]:
        """Its texts, verdict last."""
        return self.what, self.arrived, self.wanted, self.complaint or "ok"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``-c``, ``--peer``, ``--speed``, ``--timeout`` and ``--demo``."""
    add_config(parser)
    parser.add_argument(
        "--peer", metavar="NAME", help="peer to check, if there are several"
    )
    parser.add_argument(
        "--speed",
        type=float,
        default=20.0,
        metavar="RPM",
        help="speed at which each wheel should turn (%(default)s rpm)",
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=60.0,
        metavar="S",
        help="how long to wait for each wheel",
    )
    parser.add_argument(
        "--demo",
        action="store_true",
        help="use an embedded controller that turns the wheels",
    )


def run(args: argparse.Namespace) -> int:
    """Check the wiring; return 0 if it is right."""
    assembly = assemble(config_path(args))
    setup_logging(
        "ERROR", assembly.config.logging.format, assembly.config.logging.repeat_window_s
    )
    findings = event_loop.run(
        _demo(assembly, args) if args.demo else _run(assembly, args)
    )
    print(as_table(findings))
    return EXIT_FAILED if any(finding.complaint for finding in findings) else EXIT_DONE


async def _demo(assembly: Assembly, args: argparse.Namespace) -> list[WheelFinding]:
    async with running_controller(assembly.robot, pattern="wheels") as endpoint:
        return await _run(demo_assembly(assembly, endpoint), args)


async def _run(assembly: Assembly, args: argparse.Namespace) -> list[WheelFinding]:
    peers = {peer.name: peer for peer in assembly.config.peers}
    if not peers:
        raise ConfigError(
            "there is no peer to check: add one to 'peers:', or use --demo"
        )
    if args.peer is None and len(peers) > 1:
        raise ConfigError(f"which peer? name one with --peer: {', '.join(peers)}")
    name = args.peer or next(iter(peers))
    if name not in peers:
        raise ConfigError(
            f"there is no peer '{name}'; the peers are {', '.join(peers)}"
        )
    async with Daemon(assembly) as daemon:
        wiring = WheelCheck(daemon, name, args.speed, args.timeout, _say)
        return await wiring.check()


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


class WheelCheck:
    """Watches the inputs of a running daemon while the controller turns wheel after wheel."""

    def __init__(
        self,
        daemon: Daemon,
        peer: str,
        speed_rpm: float,
        timeout_s: float,
        say: Callable[[str], None],
    ) -> None:
        self._daemon = daemon
        self._peer = next(
            link for link in daemon.parts_of("peers") if link.config.name == peer
        )
        self._speed_rpm = speed_rpm
        self._timeout_s = timeout_s
        self._say = say
        # for how long this computer was too busy for a look since the last wait began
        self._busy_s = 0.0

    async def check(self) -> list[WheelFinding]:
        """Return one finding for each wheel, and one for the stale time."""
        findings: list[WheelFinding] = []
        for number, wheel in enumerate(WHEELS, 1):
            self._say(
                f"{number} of {len(WHEELS)}: let the controller turn only the {WHEEL_WORDS[wheel]}"
                f" wheel, forward, at {self._speed_rpm:g} rpm"
            )
            if number == 1 or findings[-1].arrived != "nothing":
                await self._wait(self._standing(), self._timeout_s)
            findings.append(await self._wheel(wheel))
        findings.append(await self._stale())
        return findings

    def _inputs(self) -> dict[str, float]:
        frame = self._daemon.image.latest()
        if frame is None:
            return dict.fromkeys(WHEELS, 0.0)
        slots = self._daemon.table["wheels.setpoints_rpm"].slots
        return {w: float(frame.values[s]) for w, s in zip(WHEELS, slots, strict=True)}

    def _moving(self) -> dict[str, float]:
        return {
            wheel: rpm for wheel, rpm in self._inputs().items() if abs(rpm) > MOVES_RPM
        }

    def _standing(self) -> Callable[[], bool]:
        """Return a condition: no wheel has been commanded to move for `STOOD_S`."""
        moved_s = time.monotonic()

        def stood() -> bool:
            nonlocal moved_s
            now_s = time.monotonic()
            if self._moving():
                moved_s = now_s
            return now_s - moved_s >= STOOD_S

        return stood

    async def _wait(self, condition: Callable[[], object], timeout_s: float) -> bool:
        looked_s = time.monotonic()
        end_s = looked_s + timeout_s
        self._busy_s = 0.0
        while not condition():
            if looked_s > end_s:
                return False
            await asyncio.sleep(LOOK_S)
            before_s = looked_s
            looked_s = time.monotonic()
            if looked_s - before_s > LATE_LOOK_S:
                self._busy_s += looked_s - before_s - LOOK_S
        return True

    async def _wheel(self, wheel: str) -> WheelFinding:
        wanted_rpm = self._speed_rpm if wheel.endswith("l") else -self._speed_rpm
        wanted = f"{wheel} {wanted_rpm:+g} rpm"
        if not await self._wait(self._moving, self._timeout_s):
            if self._peer.status.connected:
                why = ""
            else:
                why = f", peer: {self._peer.status.last_error}"
            return WheelFinding(wheel, "nothing", wanted, f"no input moved{why}")
        steady = moving = self._moving()

        def has_changed() -> bool:
            nonlocal steady, moving
            moving = self._moving()
            if _is_same(steady, moving):
                return False
            steady = moving
            return True

        # A controller may have a ramp, and on a busy computer its commands come with gaps: what
        # stands still again may move on.
        end_s = time.monotonic() + SETTLED_AT_MOST_S
        while time.monotonic() < end_s:
            if not await self._wait(has_changed, SETTLE_S) and steady:
                break
        arrived = ", ".join(f"{w} {rpm:+.4g} rpm" for w, rpm in moving.items())
        return WheelFinding(
            wheel, arrived or "a twitch", wanted, complaint(wheel, wanted_rpm, moving)
        )

    async def _stale(self) -> WheelFinding:
        """Cut the link and measure how long the inputs stay Good."""
        limit_ms = self._peer.config.stale_after_ms
        wanted = f"{limit_ms:g} ms, then {self._peer.config.on_stale}"
        if not self._peer.status.connected:
            return WheelFinding("stale", "nothing", wanted, "the peer is not connected")
        slot = self._daemon.table.slot("wheel.fl.setpoint_rpm")
        self._daemon.faults.inject(
            {"fault": "disconnect", "peer": self._peer.config.name}
        )
        start_s = time.monotonic()

        def is_stale() -> bool:
            frame = self._daemon.image.latest()
            return (
                frame is not None
                and int(frame.status[slot]) == UNCERTAIN_LAST_USABLE_VALUE
            )

        found = await self._wait(is_stale, limit_ms * 1e-3 + 5.0)
        took_ms = (time.monotonic() - start_s) * 1e3
        busy_ms = self._busy_s * 1e3
        self._daemon.faults.clear()
        if not found:
            return WheelFinding(
                "stale", "never", wanted, "the inputs stay Good after the link is cut"
            )
        arrived = f"{took_ms:.0f} ms"
        late_ms = STALE_TOLERANCE_MS
        if took_ms > limit_ms + late_ms and busy_ms:
            late_ms += busy_ms
            arrived += f", this computer was busy for {busy_ms:.0f} ms of them"
        # The last value came up to one publishing interval before the cut.
        early_ms = self._peer.config.publishing_ms + STALE_TOLERANCE_MS
        is_right = limit_ms - early_ms <= took_ms <= limit_ms + late_ms
        return WheelFinding(
            "stale", arrived, wanted, "" if is_right else "another time"
        )


def _is_same(before: dict[str, float], after: dict[str, float]) -> bool:
    """Whether the same wheels turn at about the same speeds."""
    return before.keys() == after.keys() and all(
        abs(rpm - before[wheel]) <= UNIT_TOLERANCE * abs(rpm)
        for wheel, rpm in after.items()
    )


def complaint(wheel: str, wanted_rpm: float, moving: dict[str, float]) -> str:
    """Return what is wrong with the wheels that moved, in words; empty if nothing is."""
    if not moving:
        return "it moved too briefly to be measured"
    if len(moving) > 1:
        return f"not alone: {', '.join(moving)} move"
    (moved, rpm) = next(iter(moving.items()))
    complaints: list[str] = []
    if moved != wheel:
        kind = "side" if moved[1] != wheel[1] else "order"
        complaints.append(
            f"{kind}: {WHEEL_WORDS[moved]} instead of {WHEEL_WORDS[wheel]}"
        )
        wanted_rpm = abs(wanted_rpm) if moved.endswith("l") else -abs(wanted_rpm)
    if rpm * wanted_rpm < 0:
        complaints.append(
            "sign: forward is positive on the left, negative on the right"
        )
    factor = abs(rpm / wanted_rpm)
    if abs(factor - 1.0) > UNIT_TOLERANCE:
        complaints.append(f"unit: {_unit(factor)}")
    return "; ".join(complaints)


def _unit(factor: float) -> str:
    for known, text in FACTORS.items():
        if abs(factor / known - 1.0) <= UNIT_TOLERANCE:
            return f"{factor:.4g} times too large, {text}"
    return f"{factor:.4g} times too large"


def as_table(findings: list[WheelFinding]) -> str:
    """Return the findings as a table."""
    rows = [("what", "arrived", "wanted", "verdict"), *(f.cells for f in findings)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) for cell, width in zip(row, widths, strict=True)
        ).rstrip()
        for row in rows
    )
