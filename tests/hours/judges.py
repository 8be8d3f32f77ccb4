"""What must hold in every tick, whatever happens: judges that look at frames and the ledger.

A judge knows no code of the product. It knows what the wheels are to do, tick by tick, and what
users said, when that reached the computer of the daemon, and what was answered.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hilserver.image import read_frames
from hilserver.signals import AUTOMATIC
from tests.control.robot import COMMANDING, STANDING_RPM, History
from tests.hours.ledger import Act, Ledger, Speed
from tests.hours.loop import NS
from tests.hours.town import RING_FRAMES, SAFE_RAMP_S, Town, stood_ns

MS = 1_000_000
STOP_MS = 50  # Stop acts within so long of being read by the daemon
LEASE_SLACK_MS = 80
RAMP_TICKS = round(SAFE_RAMP_S * 1000)
STEADY_TICKS = 5  # a ramp does not stay at a speed for so long
# from what a controller offers to what we read: a poll and the network
CONTROLLER_LAG_MS = 300
POLL_NS = 60 * MS  # a controller is read that often
DONE_NS = 20 * MS
JUMPING = {"Reset", "LoadSnapshot"}  # the plant, to another state
ENDING = {"Reset", "LoadSnapshot", "Pause"}  # hands have to let go after these


class Judges:
    """Look at what happened since they last looked; `found` has a sentence for each breach."""

    def __init__(self, town: Town, ledger: Ledger) -> None:
        self._town, self._ledger = town, ledger
        self._next = town.reader.head
        self.found: list[str] = []
        self.hands: set[str] = set()  # users who drive by hand
        self.ticks = self.moving = self.steady = 0
        self._begun_ns = town.loop.clock.now_ns
        self._rest: tuple[NDArray[np.int64], ...] | None = None
        # when the daemon heard of whom; filled by the life of the town
        self.heard_ns: dict[str, list[int]] = {}
        # when control passed, from whom, to whom
        self.owners: list[tuple[int, str, str]] = []
        self._judged: set[int] = set()

    def look(self) -> None:
        """Judge the ticks since the last look; at least once per ring of frames."""
        head = self._town.reader.head
        if head - self._next > RING_FRAMES - 64:
            self.found.append("the judges looked too late")
        if head <= self._next:
            return
        seen = History(
            read_frames(self._town.reader, self._next, head - self._next),
            self._town.slots,
        )
        self._next = head
        if not len(seen):
            return
        times_ns, rpm = seen.times_ns, seen.wheel_rpm
        self.ticks += len(rpm)
        self._judge_motion(times_ns, rpm)
        self._judge_stops(times_ns, seen)

    # --- never motion without a live lease --------------------------------------------------------

    def _judge_motion(
        self, times_ns: NDArray[np.int64], rpm: NDArray[np.float64]
    ) -> None:
        moves = np.abs(np.nan_to_num(rpm)) > STANDING_RPM
        self.moving += int(moves.sum())
        steps = np.flatnonzero(np.diff(rpm, prepend=np.nan) != 0.0)
        unknown_ticks = 0
        for first, last in zip(steps, [*steps[1:], len(rpm)], strict=True):
            if not moves[first]:
                unknown_ticks = 0
                continue
            speed = self._ledger.speeds.get(round(float(rpm[first]), 3))
            if speed is None:
                unknown_ticks += last - first
                if last - first > STEADY_TICKS or unknown_ticks > 10 * RAMP_TICKS:
                    self.breach(
                        times_ns[first], f"{rpm[first]:.3f} rpm, which nobody asks for"
                    )
                    unknown_ticks = 0
            elif last - first >= STEADY_TICKS:
                unknown_ticks = 0
                self.steady += int(last - first)
                self._judge_speed(speed, int(times_ns[first]), int(times_ns[last - 1]))

    def _judge_speed(self, speed: Speed, first_ns: int, last_ns: int) -> None:
        """Judge a stretch of ticks at one speed."""
        said = self._said_ns(speed)
        at = bisect_right(said, first_ns + MS)
        if not at:
            self.breach(
                first_ns, f"{speed.user} drives at {speed.rpm:.2f} before it was said"
            )
            return
        limit_ns = round((speed.lease_ms + LEASE_SLACK_MS) * MS)
        newest_ns = said[at - 1]
        for next_ns in [*said[at:], None]:
            until_ns = last_ns if next_ns is None else min(next_ns, last_ns)
            if until_ns - newest_ns > limit_ns:
                late_ms = (until_ns - newest_ns) / MS
                self.breach(
                    until_ns,
                    f"{speed.user} drives at {speed.rpm:.2f} rpm, {late_ms:.0f} ms after the last"
                    f" command, of which a lease has {speed.lease_ms:g}",
                )
                return
            if next_ns is None or next_ns >= last_ns:
                break
            newest_ns = next_ns
        self._judge_hand(speed, first_ns, newest_ns)
        self._judge_automatic(speed, last_ns)
        self._judge_outdated(speed, last_ns, said)
        self._judge_return(speed, first_ns, last_ns, said)

    def _said_ns(self, speed: Speed) -> list[int]:
        """Return when the daemon's computer had been told this speed, in order."""
        if speed.kind != "peer":
            return sorted(
                mark.came_ns for mark in speed.said if mark.came_ns is not None
            )
        if not speed.said_ns:
            return []
        held_ns = max((b - a for a, b in self._town.holds), default=0)
        lag_ns = CONTROLLER_LAG_MS * MS + held_ns
        first_ns, last_ns = speed.said_ns[0], speed.said_ns[-1]
        heard = self.heard_ns.get("peer", [])
        found = heard[
            bisect_left(heard, first_ns) : bisect_right(heard, last_ns + lag_ns)
        ]
        if not found or found[-1] < last_ns + POLL_NS:
            # Nobody could read it while the link was broken: it is news to whoever comes back.
            back = bisect_right(heard, last_ns + lag_ns)
            found = found + [t for t in heard[back:] if t <= heard[back] + lag_ns]
        return found

    def _judge_hand(self, speed: Speed, first_ns: int, newest_ns: int) -> None:
        """A hand has to be at neutral after a Reset before it moves anything."""
        if speed.user not in self.hands:
            return
        ended = [
            act for act in self._ledger.acts
            if act.name in ENDING and act.is_accepted and act.done_ns < newest_ns
        ]  # fmt: skip
        if not ended:
            return
        reset_ns = max(act.sent_ns for act in ended)
        rests = [
            mark.came_ns for mark in self._ledger.neutral[speed.user] if mark.came_ns
        ]
        if not any(reset_ns <= rest_ns <= newest_ns for rest_ns in rests):
            name = max(ended, key=lambda act: act.sent_ns).name
            self.breach(
                first_ns, f"{speed.user} drives after {name} without having let go"
            )

    def _judge_automatic(self, speed: Speed, last_ns: int) -> None:
        """After Stop and Reset, what is no hand drives only once somebody has asked for Start."""
        if speed.user in self.hands or speed.kind not in AUTOMATIC:
            return
        acts = self._ledger.acts
        for reset in acts:
            if not (
                reset.name == "Reset" and reset.is_accepted and reset.done_ns < last_ns
            ):
                continue
            # Where another act came between, the Reset may have acknowledged nothing.
            before = [act for act in acts if act.sent_ns < reset.sent_ns]
            if not before or before[-1].name != "Stop" or not before[-1].is_accepted:
                continue
            if before[-1].done_ns < reset.sent_ns and not any(
                act.name == "Start" and act.is_accepted is not False
                for act in acts
                if reset.sent_ns <= act.sent_ns <= last_ns
            ):
                self.breach(
                    last_ns,
                    f"{speed.user} drives after {reset.user}'s Reset, not started",
                )

    def _judge_outdated(self, speed: Speed, last_ns: int, said: list[int]) -> None:
        """What somebody said before a Reset or LoadSnapshot must not act when that is done."""
        if speed.kind == "peer":
            return
        for act in self._ledger.acts:
            is_done = (
                act.name in JUMPING
                and act.is_accepted
                and act.done_ns < last_ns - DONE_NS
            )
            if is_done and not any(act.sent_ns <= t <= last_ns for t in said):
                self.breach(
                    last_ns, f"{speed.user} drives on by what it said before {act.name}"
                )

    def _judge_return(
        self, speed: Speed, first_ns: int, last_ns: int, said: list[int]
    ) -> None:
        """What somebody said before another took control must not act when control returns."""
        if speed.kind == "peer":
            return
        back = [
            t
            for t, _, to in self.owners
            if to == speed.kind and t <= last_ns - RAMP_TICKS * MS
        ]
        if back and not any(
            t >= back[-1] - LEASE_SLACK_MS * MS for t in said if t <= last_ns
        ):
            self.breach(
                last_ns,
                f"{speed.user} drives again by what it said before it lost control",
            )

    # --- Stop within its promise ------------------------------------------------------------------

    def _judge_stops(self, times_ns: NDArray[np.int64], seen: History) -> None:
        """After Stop the robot is in the safe state until somebody has asked for Reset."""
        stands = seen["internal.command"] > COMMANDING
        stands |= np.abs(np.nan_to_num(seen.wheel_rpm)) < STANDING_RPM
        is_disabled = seen["drive.enable"] == 0
        for act in self._stops():
            begins_ns = act.mark.read_ns + STOP_MS * MS
            begins_ns += stood_ns(self._town.stalls, act.mark.read_ns, begins_ns)
            until_ns = self._reset_after(act)
            after = (times_ns >= begins_ns) & (times_ns < until_ns)
            if after.any() and not stands[after].all():
                at = times_ns[after][np.argmin(stands[after])]
                late_ms = (at - act.mark.read_ns) / MS
                self.breach(
                    at, f"it moves {late_ms:.0f} ms after {act.user}'s Stop was read"
                )
            ramped = after & (times_ns >= begins_ns + round(SAFE_RAMP_S * NS))
            if ramped.any() and not is_disabled[ramped].all():
                at = times_ns[ramped][np.argmin(is_disabled[ramped])]
                self.breach(at, f"the drive is enabled after {act.user}'s Stop")

    def _stops(self) -> Iterator[Act]:
        for act in self._ledger.acts:
            if act.name == "Stop" and act.is_accepted and act.mark and act.mark.read_ns:
                yield act

    def _reset_after(self, stop: Act) -> int:
        """Return when the first Reset was sent that may have come after this Stop."""
        later = [
            act.sent_ns for act in self._ledger.acts
            if act.name in ("Reset",) and act.is_accepted is not False
            and (act.done_ns is None or act.done_ns > stop.sent_ns)
        ]  # fmt: skip
        return min(later, default=2**62)

    # --- limits -----------------------------------------------------------------------------------

    def look_at_limits(self) -> None:
        """Compare every queue with its limit; nothing may fail where nobody would see it."""
        now_ns = self._town.loop.clock.now_ns
        for name, (found, most) in self._town.limited().items():
            if found > most:
                self.breach(now_ns, f"{name}: {found}, but at most {most}")
        for error in self._town.loop.errors:
            what = error.get("future") or error.get("handle") or ""
            why = error.get("exception", "")
            self.breach(now_ns, f"{error['message']}: {why!r} of {what}")

    def breach(self, at_ns: int, sentence: str) -> None:
        key = hash(sentence.partition(",")[0][:40])
        if key not in self._judged and len(self.found) < 20:
            self._judged.add(key)
            self.found.append(f"{(int(at_ns) - self._begun_ns) / NS:.3f} s: {sentence}")
