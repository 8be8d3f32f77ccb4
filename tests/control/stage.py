"""The robot with everybody around it: brings a source to the wheel, then lets something happen."""

import contextlib
import signal
import time

import numpy as np
import yaml

from hilserver.io.peer_link.link import SETTLED_S
from tests.control.clients import SPEEDS_RPM, RefusedError, client
from tests.control.robot import COMMUNICATION_MS, LEASE_MS, SAFE, STANDING_RPM

OFFERING = ("peer", "ros2", "shield")
"""They say what they want whether or not they have control."""
KINDS = {"foxglove": "page", "teleop": "opcua"}
SLACK_MS = 400
"""On top of a lease: the ramp, and what a computer may lose that others use as well."""
SOON_S = 60.0
WATCH_S = 0.35
UNDER_WAY_S = 0.3
FROZEN_S = 1.5
HELD_S = 5.0
FORCED_RPM = 7.0


class Stage:
    """One robot for many cells."""

    def __init__(self, robot):
        self.robot, self.clients = robot, {}
        scenarios = robot.folder / "scenarios"
        scenarios.mkdir(exist_ok=True)
        metres = SPEEDS_RPM["scenario"] / 60 * 2 * np.pi * 0.085
        drive = {
            "drive.enable": True,
            "control.mode": 1,
            "twist.linear_m_s": float(metres),
        }
        steps = [
            {"at_s": 0.0, "write": drive},
            {"at_s": 600.0, "write": {"lights.command": 1}},
        ]
        (scenarios / "drive.yaml").write_text(
            yaml.safe_dump({"steps": steps}), encoding="utf-8"
        )
        self.restore()

    @property
    def eye(self):
        return self.robot.eye

    def restore(self):
        """Everybody is there again who belongs here."""
        for kind in ("engineer", "operator", "opcua", "page", "foxglove", *OFFERING):
            if kind not in self.clients:
                self.clients[kind] = client(kind, self.robot.doors)
                self.clients[kind].do("connect")
        for kind in OFFERING:
            self.clients[kind].do("drive")

    def forget(self, *kinds):
        for kind in kinds or tuple(self.clients):
            gone = self.clients.pop(kind, None)
            if gone is not None:
                gone.end()

    def call(self, method, *arguments):
        try:
            self.clients["operator"].do("call", method, *arguments)
        except (
            RefusedError
        ) as error:  # whoever looks on may not disturb; a test stand may
            if "take control first" not in str(error) or method in ("give", "write"):
                raise
            self.clients["engineer"].do("call", method, *arguments)

    def wait(self, condition, within_s=SOON_S):
        end_s = time.monotonic() + within_s
        while not condition():
            if time.monotonic() > end_s:
                return False
            time.sleep(0.005)
        return True

    def turns(self, rpm):
        """Whether the wheel is to turn so fast."""
        return abs(self.eye.now().wheel_rpm[-1] - rpm) < STANDING_RPM

    # --- before a cell ----------------------------------------------------------------------------

    def begin(self, source):
        """Let the peer drive, then `source`; a robot that is not fit for that is started again."""
        try:
            self._begin(source)
        except (AssertionError, RefusedError):
            self.robot.stop(signal.SIGKILL)
            self.forget()
            self.robot.start()
            self._begin(source)

    def _begin(self, source):
        self.restore()
        for method in ("StopScenario", "Reset", "Start", "ClearFaults"):
            self._try(method)
        for name in ("twist.linear_m_s", "wheel.fl.setpoint_rpm"):
            self._try("Unforce", name)
        self.call("SetSpeed", 1.0)
        for kind in ("page", "foxglove"):
            self.clients[kind].do("rest")
        self.forget("teleop")
        self._try("give", "page")
        for name in (
            "control.mode",
            "twist.linear_m_s",
        ):  # what somebody may have left behind
            self._try("write", name, 0)
        self._try("give", "peer")
        self._try("Reset")
        assert self.wait(self._peer_drives), "the peer does not drive"
        if source != "peer":
            head = self.eye.head
            self.take(source)
            self.drive(source)
            self._goes_over(source, head)

    def _peer_drives(self):
        """Whether the peer drives; its silence before may have stopped the robot."""
        if self.eye.now()["sim.state"][-1] == SAFE:
            self._try("Reset")
            self._try("Start")
        return self.turns(SPEEDS_RPM["peer"])

    def _try(self, method, *arguments):
        with contextlib.suppress(RefusedError):
            self.call(method, *arguments)

    def take(self, source):
        if source == "scenario":
            self.call("StartScenario", "drive.yaml")
        elif source in ("opcua", "page"):
            self.clients[source].do("take")
        elif source == "teleop":
            self.clients[source] = client(source, self.robot.doors)
            self.clients[source].do("take")
        elif self.eye.driver() != (kind := KINDS.get(source, source)):
            self.clients["engineer"].do("take", kind)

    def drive(self, source):
        if source != "scenario":
            self.clients[source].do("drive")

    def rest(self, source):
        if source != "scenario":
            self.clients[source].do("rest")
            time.sleep(UNDER_WAY_S)  # what was said before is still on its way

    # --- what happens -----------------------------------------------------------------------------

    def happen(self, event, source):
        """Let it happen; return the number of the first frame, and the time, from which to look."""
        name = event.replace(" ", "_")
        head, at_ns = self.eye.head, time.monotonic_ns()
        if event.startswith("taken by "):
            self._taken(event.removeprefix("taken by "), source)
            return head, at_ns
        found = getattr(self, f"_{name}")(source)
        return (head, at_ns) if found is None else found

    def _taken(self, other, source):
        if KINDS.get(other, other) == KINDS.get(source, source):
            self.rest(source)  # two people with one seat
        self.take(other)
        self.drive(other)

    def _given_back(self, source):
        if source == "scenario":
            self.call("StopScenario")
        else:
            giver = "opcua" if source == "opcua" else "engineer"
            if KINDS.get(source, source) == "page":
                self.call("give", "peer")
            else:
                self.clients[giver].do("take", "peer")

    def _closed(self, source):
        if source == "scenario":
            self.forget("operator")
        else:
            self.clients[source].do("close")
            self.forget(source)

    def _cut(self, source):
        if source == "peer":
            # a link of less comes back later than what is missing is stale
            time.sleep(SETTLED_S)
        self.clients[source].do("cut")

    def _killed(self, source):
        self.clients[source].kill()
        self.forget(source)

    def _silent(self, source):
        self.clients[source].freeze()

    def _stopped(self, source):
        self.clients["engineer"].do("call", "Stop")

    def _lock_held(self, source):
        self.robot.hold(HELD_S)

    def _between(self, first, second, *arguments):
        self.call(first)
        time.sleep(0.03)
        head, at_ns = self.eye.head, time.monotonic_ns()
        self.call(second, *arguments)
        return head, at_ns

    def _paused(self, source):
        self.rest(source)
        return self._between("Pause", "Start")

    def _stepped(self, source):
        self.rest(source)
        return self._between("Pause", "Step", 50)

    def _slowed(self, source):
        self.call("SetSpeed", 0.25)
        time.sleep(0.05)
        head, at_ns = self.eye.head, time.monotonic_ns()
        self.rest(source)
        return head, at_ns

    def _reset(self, source):
        self.rest(source)
        return self._from_call("Reset")

    def _from_call(self, method, *arguments):
        self.call(method, *arguments)
        return self.eye.head, time.monotonic_ns()

    def _snapshot(self, source):
        name = f"drive-{time.monotonic_ns()}"
        self.call("SaveSnapshot", name)
        self.rest(source)
        return self._from_call("LoadSnapshot", name)

    def _overrun(self, source):
        self.rest(source)
        self.robot.freeze(FROZEN_S)
        return self.eye.head, time.monotonic_ns()

    def _forced(self, source):
        name = "wheel.fl.setpoint_rpm" if source in OFFERING else "twist.linear_m_s"
        value = (
            FORCED_RPM if source in OFFERING else FORCED_RPM / 60 * 2 * np.pi * 0.085
        )
        self.call("Force", name, value)
        assert self.wait(lambda: self.turns(FORCED_RPM)), "the force does not act"
        self.call("Unforce", name)

    def _acknowledged(self, source):
        self.rest(source)
        self._stop()
        return self._from_call("Reset")

    def _stop(self):
        self.call("Stop")
        assert self.wait(lambda: self.eye.now()["drive.enable"][-1] == 0), (
            "no safe state"
        )

    def _held_over(self, source):
        if source == "opcua":  # a program that writes again and again
            self.clients[source].do("hold")
        self._stop()
        return self._from_call("Reset")

    def _restarted(self, source):
        self.robot.stop(signal.SIGTERM)
        self.robot.start()
        # The serial line is another one now.
        self.forget(
            *(kind for kind in self.clients if kind not in OFFERING or kind == "shield")
        )
        return 0, time.monotonic_ns()  # another image, which begins anew

    # --- what has to follow -----------------------------------------------------------------------

    def check(self, event, source, outcome, head, at_ns):
        """Fail with a sentence if another outcome follows."""
        other = (
            event.removeprefix("taken by ") if event.startswith("taken by ") else "peer"
        )
        judge = getattr(self, f"_is_{outcome}")
        judge(source, other, head, at_ns)

    def _is_driven_by(self, source):
        driver = self.eye.driver()
        assert driver == KINDS.get(source, source), f"{driver} drives"

    def _goes_over(self, other, head):
        def has_stood():
            return (np.abs(self.eye.since(head).wheel_rpm) < STANDING_RPM).any()

        rpm = SPEEDS_RPM[other]
        assert self.wait(has_stood), f"{self._says()}: it does not begin at zero"
        assert self.wait(lambda: self.turns(rpm)), (
            f"{self._says()} instead of {rpm:g} rpm"
        )
        self._is_driven_by(other)

    def _is_taken(self, _source, other, head, _at_ns):
        self._goes_over(other, head)

    def _is_before(self, _source, _other, head, _at_ns):
        self._goes_over("peer", head)

    def _is_drives(self, source, _other, head, _at_ns):
        time.sleep(WATCH_S)
        wheel = self.eye.since(head).wheel_rpm
        assert np.allclose(wheel, SPEEDS_RPM[source], atol=STANDING_RPM), self._says()
        self._is_driven_by(source)

    _is_refused = _is_drives

    def _is_forced(self, source, _other, _head, _at_ns):
        assert self.wait(lambda: self.turns(SPEEDS_RPM[source])), self._says()
        self._is_driven_by(source)

    def _stands(self, source, head, at_ns):
        """From the end of its lease on nothing turns, whatever was still under way."""
        limit_ms = (LEASE_MS[source] or COMMUNICATION_MS) + SLACK_MS
        end_s = (at_ns + limit_ms * 1e6) / 1e9 + WATCH_S
        time.sleep(max(end_s - time.monotonic(), 0.0))
        ends_ns = at_ns + limit_ms * 1e6
        is_over = lambda: self.eye.since(head).times_ns.max(initial=0) >= ends_ns  # noqa: E731
        assert self.wait(is_over, SOON_S), f"no tick after {limit_ms} ms"
        seen = self.eye.since(head)
        turns_ns = seen.times_ns[~seen.stands]
        late_ms = (turns_ns.max(initial=at_ns) - at_ns) / 1e6
        assert late_ms <= limit_ms, (
            f"{self._says()}: it turns for {late_ms:.0f} ms, {limit_ms} are allowed"
        )

    def _is_zero(self, source, _other, head, at_ns):
        self._stands(source, head, at_ns)
        self._is_driven_by(source)

    def _is_nobody(self, source, _other, head, at_ns):
        self._stands(source, head, at_ns)
        driver = self.eye.driver()
        assert driver in ("nobody", ""), f"{driver} drives"

    def _is_off(self, source, _other, head, at_ns):
        self._stands(source, head, at_ns)
        assert self.eye.now()["drive.enable"][-1] == 0, "the drive is enabled"

    def _is_safe(self, source, _other, head, at_ns):
        self._stands(source, head, at_ns)
        is_safe = lambda: self.eye.now()["sim.state"][-1] == SAFE  # noqa: E731
        assert self.wait(is_safe, HELD_S + SOON_S), "no safe state"

    def _is_anew(self, source, _other, head, _at_ns):
        assert self.wait(lambda: len(self.eye.since(head)) >= 50), "no tick"
        wheel = self.eye.since(head).wheel_rpm[:50]
        wheel = wheel[~np.isnan(wheel)]
        assert not (np.abs(wheel) > STANDING_RPM).any(), (
            f"it goes on with {wheel[0]:.1f} rpm"
        )
        self._is_driven_by(source)

    def _stays(self, head):
        """It stands, and goes on to stand, although somebody commands."""
        time.sleep(WATCH_S)
        wheel = self.eye.since(head).wheel_rpm
        wheel = wheel[~np.isnan(wheel)]
        assert len(wheel), "no tick after the safe state"
        assert not (np.abs(wheel) > STANDING_RPM).any(), f"it drives: {self._says()}"

    def _is_start(self, source, _other, head, _at_ns):
        self._stays(head)
        assert self.eye.now()["control.waits_for_start"][-1] == 1
        self.call("Start")
        assert self.wait(lambda: self.turns(SPEEDS_RPM[source])), (
            f"{self._says()} after Start"
        )
        self._is_driven_by(source)

    def _is_rest(self, source, _other, head, _at_ns):
        self._stays(head)
        self.clients[source].do("let_go")
        self.drive(source)
        assert self.wait(lambda: self.turns(SPEEDS_RPM[source])), (
            f"{self._says()} after rest"
        )
        self._is_driven_by(source)

    def _says(self):
        now = self.eye.now()
        return f"{now.wheel_rpm[-1]:.1f} rpm in state {now['sim.state'][-1]:.0f}"
