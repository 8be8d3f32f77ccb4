"""Which of the channels that may be a signal is it: numbers decide before names, and say why."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from hilserver.measured.channels import (
    FIX,
    FIX_LATITUDE,
    FIX_LONGITUDE,
    GYRO,
    IMU_YAW,
    NAV_X,
    NAV_Y,
    TWIST,
    YAW,
)
from hilserver.measured.evidence import (
    CLEARLY,
    LEAST,
    UNSEEN,
    Motion,
    Samples,
    motion_of,
    speed,
    turning,
)

_GENTLY: Final = 0.02  # of a correlation: equal ones leave the choice to the names


@dataclass(frozen=True, slots=True)
class Candidate:
    """A channel that may be a signal."""

    signal: str
    line: str  # of a mapping file, without its reason
    group: str  # what belongs together: the topic, or the name without its axis
    rank: int = 0  # of the name or the type; the lowest is the likeliest
    why: str = "by its name"
    samples: Samples = UNSEEN


@dataclass
class Choice:
    """The channels that were chosen, as lines of a mapping file by signal."""

    lines: dict[str, str] = field(default_factory=dict)
    groups: dict[str, str] = field(default_factory=dict)

    def take(self, candidate: Candidate, why: str) -> None:
        """Choose a channel for a signal that has none yet."""
        if candidate.signal not in self.lines:
            mark = "; " if "   # " in candidate.line else "   # "
            self.lines[candidate.signal] = f"{candidate.line}{mark}{why}"
            self.groups[candidate.signal] = candidate.group


def choose(found: Sequence[Candidate]) -> Choice:
    """Return the likeliest channel of every signal."""
    by_signal: dict[str, list[Candidate]] = {}
    for candidate in sorted(found, key=lambda c: c.rank):
        by_signal.setdefault(candidate.signal, []).append(candidate)
    choice = Choice()
    motion = _motion(by_signal)
    is_fixed = {FIX_LATITUDE, FIX_LONGITUDE} <= by_signal.keys()
    is_tracked = any(c.rank <= 0 for c in by_signal.get(NAV_X, ()))
    # A robot has one position: satellites come before what may be the wheels' odometry.
    for name in (NAV_X, NAV_Y) if is_fixed and not is_tracked else FIX:
        by_signal.pop(name, None)
    for candidate in found:
        if candidate.rank < 0:  # it has the name of the signal
            choice.take(candidate, candidate.why)
    for signal, candidates in by_signal.items():
        if signal in (NAV_X, NAV_Y, YAW):
            continue
        if signal in (GYRO, IMU_YAW):
            _take_turning(choice, candidates, motion)
            continue
        first = next((c for c in candidates if c.samples.moves), candidates[0])
        is_still = len(first.samples.t) > 0 and not first.samples.moves
        choice.take(first, f"{first.why}; never changes" if is_still else first.why)
    _take_pose(choice, by_signal, motion)
    return choice


def has_wheels(found: Iterable[Candidate]) -> bool:
    """Return whether speeds or angles of wheels on both sides may be among the channels."""
    sides = set()
    for candidate in found:
        if candidate.signal.endswith(("speed_rpm", "angle_rad")):
            sides.add(candidate.signal[:8][-1])  # wheel.fl
    return {"l", "r"} <= sides


def _motion(by_signal: Mapping[str, list[Candidate]]) -> Motion | None:
    """Return the motion that the wheels show, else the commands."""
    for quantity, words in (
        ("speed_rpm", "the wheels"),
        ("angle_rad", "the wheels"),
        ("setpoint_rpm", "the set-points"),
    ):
        sides = []
        for wheel in ("fl", "fr"):
            other = wheel.replace("f", "r")
            of_side = [
                *by_signal.get(f"wheel.{wheel}.{quantity}", ()),
                *by_signal.get(f"wheel.{other}.{quantity}", ()),
            ]
            moving = [c.samples for c in of_side if c.samples.moves]
            sides.append(moving[0] if moving else UNSEEN)
        left, right = sides
        if quantity == "angle_rad":
            left = left.rate
            right = right.rate
        motion = motion_of(left, right, words)
        if motion is not None:
            return motion
    sent = [c.samples for name in TWIST for c in by_signal.get(name, ())[:1]]
    if len(sent) == len(TWIST) and any(s.moves for s in sent):
        forward, turn = sent
        return Motion(forward, turn, "the commands")
    return None


def _take_turning(
    choice: Choice, candidates: Sequence[Candidate], motion: Motion | None
) -> None:
    """Choose what turns with the wheels; the name or the axis decides between equal ones."""
    best = candidates[0]
    best_fit = -1.0
    for candidate in candidates:
        fit = 0.0
        if motion is not None:
            is_angle = candidate.signal == IMU_YAW
            seen = turning(candidate.samples) if is_angle else candidate.samples
            fit = motion.turns(seen)
        more = CLEARLY if candidate.rank > best.rank else _GENTLY
        if best_fit < 0.0 or fit > best_fit + more:
            best, best_fit = candidate, fit
    if motion is None or not best.samples.moves:
        if best.rank == 0:
            choice.take(best, best.why)
    elif best_fit >= LEAST:
        choice.take(best, f"turns with {motion.source} (r = {best_fit:.2f})")
    elif best.rank == 0:
        choice.take(
            best, f"{best.why}, but it does not turn with {motion.source}: check"
        )


def _take_pose(
    choice: Choice, by_signal: Mapping[str, list[Candidate]], motion: Motion | None
) -> None:
    """Choose a place whose x and y belong together and move with the wheels, and its heading."""
    of_y = {c.group: c for c in reversed(by_signal.get(NAV_Y, []))}
    group, best_fit = "", -1.0
    place: tuple[Candidate, Candidate] | None = None
    for x in by_signal.get(NAV_X, []):
        y = of_y.get(x.group)
        if y is None:
            continue
        fit = 0.0
        if motion is not None:
            fit = motion.moves(speed(x.samples, y.samples))
        # By its rank, unless the numbers say that it is none and another one is.
        if place is None or best_fit < LEAST <= fit:
            place = (x, y)
            best_fit = fit
    if place is not None:
        x, y = place
        why = x.why
        if motion is not None and x.samples.moves:
            why = f"moves with {motion.source} (r = {best_fit:.2f})"
            if best_fit < LEAST:
                why = f"{x.why}, but it does not move with {motion.source}: check"
        choice.take(x, why)
        choice.take(y, why)
        group = x.group

    headings = by_signal.get(YAW, [])
    best_fit, best_yaw = -1.0, None
    for candidate in sorted(headings, key=lambda c: (c.group != group, c.rank)):
        fit = 0.0 if motion is None else motion.turns(turning(candidate.samples))
        if best_yaw is None or fit > best_fit + CLEARLY:
            best_fit, best_yaw = fit, candidate
    if best_yaw is not None:
        is_seen = motion is not None and best_fit >= LEAST
        why = best_yaw.why
        if is_seen and motion is not None:
            why = f"turns with {motion.source} (r = {best_fit:.2f})"
        elif best_yaw.group == group:
            why = f"{why}, beside the position"
        choice.take(best_yaw, why)
