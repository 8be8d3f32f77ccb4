"""How late the set-points begin to fall, again and again: after the last message, and after Stop.

A client of its own process drives; the times at which its last message left and the set-points left
what it commanded are of one clock. The latter is read in shared memory.
"""

import random
import time
from dataclasses import dataclass, field

import numpy as np

from tests.control.clients import SPEEDS_RPM, RefusedError, client
from tests.control.robot import STANDING_RPM
from tests.control.trials.attacks import attack

WHATS = ("deadman", "stop")
LIMITS_MS = {"deadman": 30.0, "stop": 50.0}
DEADLINE_MS = 200
SETTINGS = {
    "control": {"source": "opcua", "opcua_stale_after_ms": DEADLINE_MS},
    "page": {"deadman_ms": DEADLINE_MS},
    "ros2": {"stale_after_ms": DEADLINE_MS, "on_stale": "ramp"},
    "logging": {"format": "json"},
    "scheduler": {"policy": "skip"},
}
"""Of the daemon; whoever goes silent is stopped for good, so that every trial begins alike."""
DRIVES_WITHIN_S = 30.0
FALLS_WITHIN_S = 10.0
LOOK_S = 0.02
AT_WORK_S = (0.1, 0.4)
"""So long an attack goes on before the moment that counts."""
LOCK_S = 0.5
"""The lock is kept for this much longer than the deadline."""


class NotDrivenError(Exception):
    """The robot does not do what the source commands."""


@dataclass
class Row:
    """What so many trials have shown.

    Attributes
    ----------
    late_ms : list of float
        After the deadline, or after the press.
    n_stopped : int
        Trials in which the attack had stopped the robot before.
    error : str
        Why there are no more.
    """

    what: str
    source: str
    attack: str
    late_ms: list = field(default_factory=list)
    n_stopped: int = 0
    error: str = ""

    @property
    def limit_ms(self):
        return LIMITS_MS[self.what]

    def at(self, share):
        return float(np.quantile(self.late_ms, share)) if self.late_ms else float("nan")


class Trials:
    """One source that drives one robot beside one attack."""

    def __init__(self, robot, source, attack_name, seed):
        self.robot, self.source = robot, source
        self._random = random.Random(seed)
        self._attack_name, self._refused = attack_name, ""
        self.clients = {}
        for kind in dict.fromkeys(("operator", "engineer", source)):
            self.clients[kind] = client(kind, robot.doors)
            self.clients[kind].do("connect")
        self._attack = attack(attack_name, robot)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._attack.end()
        for each in self.clients.values():
            each.end()

    def row(self, what, n):
        """Make `n` trials."""
        row = Row(what, self.source, self._attack_name)
        try:
            while len(row.late_ms) < n and row.n_stopped < n + 3:
                late_ms = self._trial(what)
                if late_ms is None:
                    row.n_stopped += 1
                else:
                    row.late_ms.append(late_ms)
        except (AssertionError, NotDrivenError, RefusedError, OSError) as error:
            row.error = f"{type(error).__name__}: {error}"
        return row

    def _trial(self, what):
        """Return how late it was [ms]; None if the robot had been stopped before."""
        self._bring_to_speed()
        try:
            self._attack.on()
            time.sleep(self._random.uniform(*AT_WORK_S))
            head = self.robot.eye.head
            if not self._is_at_speed():
                return None
            return getattr(self, f"_{what}")(head)
        finally:
            self._attack.off()

    def _deadman(self, head):
        self._attack.strike(DEADLINE_MS / 1e3 + LOCK_S)
        self.clients[self.source].ask("rest")
        falls_ns = self._falls_ns(head, DEADLINE_MS / 1e3)
        said_ns = self.clients[self.source].answer()
        return (falls_ns - said_ns) / 1e6 - DEADLINE_MS if falls_ns > said_ns else None

    def _stop(self, head):
        self._attack.strike(LOCK_S)
        # With the event loop dead only the page's door is open.
        by = (
            "opcua"
            if self.source == "opcua" and self._attack_name != "lock"
            else "operator"
        )
        self.clients[by].ask("press")
        falls_ns = self._falls_ns(head, 0.0)
        pressed_ns = self.clients[by].answer()
        return (falls_ns - pressed_ns) / 1e6 if falls_ns > pressed_ns else None

    def _falls_ns(self, head, at_least_s):
        """Return when the set-points left what is commanded [ns], from frame `head` on."""
        time.sleep(at_least_s)
        end_s = time.monotonic() + FALLS_WITHIN_S
        while time.monotonic() < end_s:
            time.sleep(LOOK_S)
            seen = self.robot.eye.since(head)
            falls = np.flatnonzero(
                ~np.isclose(seen.wheel_rpm, SPEEDS_RPM[self.source], atol=STANDING_RPM)
            )
            if len(falls):
                return int(seen.times_ns[falls[0]])
        raise NotDrivenError(f"it goes on for {FALLS_WITHIN_S:g} s")

    def _is_at_speed(self):
        wheel = self.robot.eye.now().wheel_rpm
        return (
            len(wheel) > 0 and abs(wheel[-1] - SPEEDS_RPM[self.source]) < STANDING_RPM
        )

    def _bring_to_speed(self):
        """Reset and take control as often as it needs."""
        end_s = time.monotonic() + DRIVES_WITHIN_S
        self.clients[self.source].do("hold")
        for patience_s in (0.1, 0.3, *(1.0,) * 100):
            if self._reaches_speed(patience_s):
                return
            if time.monotonic() > end_s:
                break
            for method in ("Reset", "Start"):
                self._try("engineer", "call", method)
            if self._reaches_speed(patience_s):
                return
            self._take()
        raise NotDrivenError(f"it cannot be made to drive: {self._refused}")

    def _reaches_speed(self, within_s):
        end_s = time.monotonic() + within_s
        while not self._is_at_speed():
            if time.monotonic() > end_s:
                return False
            time.sleep(LOOK_S / 4)
        return True

    def _take(self):
        if self.source == "ros2":
            self._try("engineer", "take", "ros2")
        else:
            self._try(self.source, "take")
        # a hand has to be at rest once since the Reset
        self._try(self.source, "rest")
        self._try(self.source, "hold")

    def _try(self, kind, *what):
        try:
            self.clients[kind].do(*what)
        except RefusedError as error:
            self._refused = str(error)
