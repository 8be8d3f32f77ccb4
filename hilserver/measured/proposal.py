"""A mapping file for a foreign log, guessed from the names of its columns."""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from hilserver.errors import LogError
from hilserver.logs.csv_times import TEXTS, kind_of
from hilserver.logs.table import BLOCK, SEGMENT, TIME
from hilserver.measured.candidates import Candidate, choose
from hilserver.measured.channels import (
    FIX_LATITUDE,
    FIX_LONGITUDE,
    GYRO,
    IMU_YAW,
    NAV_X,
    NAV_Y,
    VOLTAGE,
    YAW,
)
from hilserver.measured.evidence import UNSEEN, Samples
from hilserver.measured.mapping import DATED
from hilserver.measured.names import (
    in_brackets,
    is_other_unit,
    mapped_units,
    unit_in_name,
)
from hilserver.measured.stamps import DIGITS, TimeColumns, columns_of, unit_in_words

FILE: Final = "mapping.yaml"
_WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_WHEELS: Final = (
    ({"fl", "frontleft", "leftfront"}, ("fl",)),
    ({"rl", "rearleft", "leftrear", "bl"}, ("rl",)),
    ({"fr", "frontright", "rightfront"}, ("fr",)),
    ({"rr", "rearright", "rightrear", "br"}, ("rr",)),
    ({"left", "links"}, ("fl", "rl")),
    ({"right", "rechts"}, ("fr", "rr")),
)
_INITIALS: Final = {"l": ("fl", "rl"), "r": ("fr", "rr")}
"""Of sides, in names that speak of wheels."""
_TIMES: Final = {
    "t",
    "time",
    "timestamp",
    "stamp",
    "sec",
    "secs",
    "seconds",
    "nsecs",
    "xvalue",
    "zeit",
}
SENT: Final = {
    "setpoint",
    "set",
    "cmd",
    "command",
    "target",
    "ref",
    "desired",
    "sp",
    "goal",
}
_DUTY: Final = {"duty", "pwm", "effort"}
_SPEED: Final = {"speed", "vel", "velocity", "rpm", "omega", "w"}
_COUNTS: Final = {
    "tick",
    "ticks",
    "count",
    "counts",
    "counter",
    "enc",
    "encoder",
    "pulses",
}
_ANGLE: Final = {"angle", "position", "pos"}
_OTHER: Final = {
    "current",
    "torque",
    "temp",
    "temperature",
    "force",
    "amps",
    "acc",
    "name",
    "id",
    *(
        "range",
        "distance",
        "dist",
        "sonar",
        "ir",
        "tof",
        "laser",
        "lidar",
        "bumper",
        "line",
    ),
    *("voltage", "power", "status", "error", "err", "kp", "ki", "kd", "pid", "mid"),
}
"""Other quantities of a side, for which there is no signal."""
_SEEN: Final = {
    "marker",
    "markers",
    "aruco",
    "fiducial",
    "tvec",
    "rvec",
    "landmark",
    "obstacle",
}
"""What a camera sees of its surroundings, which is neither the robot nor a part of it."""
TRUTH: Final = {
    "ground",
    "truth",
    "groundtruth",
    "gt",
    "mocap",
    "vicon",
    "optitrack",
    "tracker",
}
_OF_IMU: Final = {"z", "wz", "gz", "gyro", "rate", "yawrate", "omega", "angular"}
_OTHER_AXES: Final = {"x", "y", "pitch", "roll", "wx", "wy", "gx", "gy"}
_NO_RATE: Final = {
    "accel",
    "acc",
    "linear",
    "mag",
    "quat",
    "temp",
    "temperature",
    "orientation",
}
_NO_PLACE: Final = {"imu", "gyro", "q", "v", "vel", "velocity", "b", "bias", *_NO_RATE}
_AXES: Final = {
    "x",
    "y",
    "px",
    "py",
    "tx",
    "ty",
    "posx",
    "posy",
    "m",
    "cm",
    "mm",
    "rad",
    "deg",
    "pos",
}
ODOMETRY: Final = {"odom", "odometry", "wheelodom"}
_NUMBERED: Final = re.compile(r"(.*?)\[?(\d)\]?(\D*)")
_OF_WHEELS: Final = {*_SPEED, *_COUNTS, *_ANGLE, *_DUTY, "wheel", "motor", "joint"}
_ORDER: Final = {2: ("left", "right"), 4: ("fl", "fr", "rl", "rr")}
_TURN: Final = {"yaw", "theta", "heading", "psi"}
_OF_ONE_AXIS: Final = _AXES | _TURN
_GYRO: Final = {"gyro", "yawrate", "wz", "gz"}
_VOLTAGE: Final = {"voltage", "battery", "vbat", "volt"}

_NO_DEGREES: Final = {"std", "sd", "error", "err", "accuracy", "covariance", "var"}
"""What a receiver says of its latitude and longitude."""

_ANY_COMMAND: Final = {"vel", "velocity", "cmd", "command"}
_RULES: Final[tuple[tuple[str, tuple[set[str], ...], set[str]], ...]] = (
    ("twist.linear_m_s", (SENT, {"linear", "v", "vx"}), {"y", "z", "angular"}),
    ("twist.angular_rad_s", (SENT, {"angular", "w", "wz", "omega"}), {"x", "y"}),
    ("twist.linear_m_s", (SENT, _ANY_COMMAND, {"x"}), {"linear", "angular"}),
    ("twist.angular_rad_s", (SENT, _ANY_COMMAND, {"z"}), {"linear", "angular"}),
    ("", (SENT,), set()),
    (IMU_YAW, (_TURN, {"imu"}), _OF_IMU),
    (GYRO, (_GYRO,), _NO_RATE),
    (GYRO, ({"imu"}, _OF_IMU), _NO_RATE),
    (YAW, (_TURN,), set()),
    (VOLTAGE, (_VOLTAGE,), set()),
    (FIX_LATITUDE, ({"latitude", "lat"},), _NO_DEGREES),
    (FIX_LONGITUDE, ({"longitude", "lon", "lng"},), _NO_DEGREES),
    (NAV_X, ({"x", "px", "tx", "posx"},), _NO_PLACE),
    (NAV_Y, ({"y", "py", "ty", "posy"},), _NO_PLACE),
)
"""Signals of names: a word of each set is in them, and none of the last one."""


class ForeignLog(LogError):
    """A log without any of our signals."""

    def __init__(self, message: str, proposal: str) -> None:
        super().__init__(message)
        # text of a mapping file that may fit; empty without a guess
        self.proposal = proposal


class Head(NamedTuple):
    """What is known of a foreign table before it is mapped."""

    header: Sequence[str]
    # the first row: it holds the names of joints if columns are numbered
    first: Sequence[str] = ()
    numbers: Mapping[str, Samples] = {}  # of the columns, as far as they were read
    types: Mapping[
        str, str
    ] = {}  # columns that are times by their type, with their unit
    units: Mapping[str, str] = {}  # what a row of units says, by column
    row: int = 1  # of the header

    @property
    def stamps(self) -> TimeColumns:
        """The columns of the time; an empty name if none is recognised."""
        time = time_column(self.header, self.types, self.first) or ""
        return columns_of(time, None, self.header, self.first)


def propose(head: Head) -> str:
    """Return the text of a mapping file for a table; empty without a guess."""
    time = "time: {rate_hz: 50}   # no time column was recognised: write the row rate"
    if head.stamps.time:
        # With the unit that its name or its first number shows.
        stamps = head.stamps
        texts = dict(zip(head.header, head.first, strict=False))
        first = texts.get(stamps.time, "").strip()
        kind = kind_of(first)
        parts = [f"column: {quoted(stamps.time)}"]
        if stamps.rest is not None:
            parts.append(f"rest: {quoted(stamps.rest)}")
        if kind == "date":
            parts.append(f"unit: {DATED}")
        elif stamps.time not in head.types and kind not in TEXTS:
            by_digits = DIGITS.get(len(first) if first.isdecimal() else 0, "s")
            parts.append(f"unit: {unit_in_words(stamps.time) or by_digits}")
        time = f"time: {{{', '.join(parts)}}}"
    return text(choose(candidates_of(head)).lines, time)


def candidates_of(head: Head) -> list[Candidate]:
    """Return what each column of a table may be."""
    found: list[Candidate] = []
    apart = {head.stamps.time, head.stamps.rest, TIME, SEGMENT, BLOCK, ""}
    for name, words in zip(head.header, meanings(head.header, head.first), strict=True):
        seen = head.numbers.get(name, UNSEEN)
        is_empty = name in head.numbers and not len(seen.t)
        if name in apart or is_empty:
            continue
        at = f"column: {quoted(name)}"
        if name in mapped_units():
            own = f"  {name}: {{{at}}}"
            found.append(Candidate(name, own, "own", -1, "its own name", seen))
            continue
        said = [head.units.get(name, ""), *in_brackets(name)]
        # What a name shares with those of the other axes.
        singles = [word.lower() for word in _WORD.findall(name)]
        group = " ".join(word for word in singles if word not in _OF_ONE_AXIS)
        for signal, written in lines(name, words, at):
            rank = _rank(words, signal)
            is_other = any(is_other_unit(unit, mapped_units()[signal]) for unit in said)
            is_axis_unseen = signal == GYRO and rank > 0 and seen is UNSEEN
            if not is_other and not is_axis_unseen:
                found.append(
                    Candidate(signal, written, group, rank, "by its name", seen)
                )
    return found


def time_column(
    header: Sequence[str],
    types: Mapping[str, str] | None = None,
    first: Sequence[str] = (),
) -> str | None:
    """Return the column of the times, by its type or else by its name; one without any is none."""
    texts = dict(zip(header, first, strict=False))
    full = [name for name in header if texts.get(name, "0")]
    named = [name for name in full if words_of(name) & _TIMES]
    typed = [name for name in header if name in (types or {})]
    return next(iter([*typed, *named]), None)


def _rank(words: set[str], signal: str) -> int:
    """Return how likely a name is what it may be; 0 is the likeliest."""
    if signal == GYRO:
        return int(bool(words & _OTHER_AXES))
    is_place = signal in (NAV_X, NAV_Y, YAW)
    return 1 if is_place and words & ODOMETRY and not words & TRUTH else 0


def text(channels: Mapping[str, str], *time: str) -> str:
    """Return a mapping file with the lines of its channels; empty without a channel."""
    if not channels:
        return ""
    parts = [
        "# Guessed from types, numbers and names: check every line, especially units and signs.",
        "# Right wheels turn backward when the robot drives forward: if the log counts forward as",
        "# positive for them, 'sign: -1' reverses it.",
        *time,
        "# The recorded machine, if it is not the configured one. Two wheels: no wheelbase_m.",
        "# plant: {wheel_radius_m: 0.1, track_m: 0.4, wheelbase_m: 0.3}",
        "plant: {}",
        "channels:",
        *(channels[signal] for signal in sorted(channels)),
    ]
    return "\n".join(parts) + "\n"


def lines(name: str, words: set[str], at: str) -> Iterator[tuple[str, str]]:
    """Yield each signal that numbers of this name may be, with its line of a mapping file."""
    for signal in _signals(words, _unit(name, "wheel.fl.speed_rpm")):
        yield signal, line(signal, name, words, at)


def line(signal: str, name: str, words: set[str], at: str) -> str:
    """Return the line of a signal `at` a column, or topic and field."""
    unit = _unit(name, signal)
    note = ""
    if signal.endswith("angle_rad") and words & _COUNTS:
        unit = ', unit: "1", scale: 0.001'
        note = "   # counts: the scale is 2 pi / counts per revolution"
    elif (
        signal.endswith(("speed_rpm", "setpoint_rpm"))
        and not unit
        and "velocity" in words
    ):
        unit, note = ", unit: rad/s", "   # rad/s, as in JointState?"
    elif signal.endswith("speed_rpm") and not unit and "rpm" not in words:
        note = "   # rpm? For counts use wheel.fl.angle_rad with a scale"
    elif signal.startswith("nav.") and words & ODOMETRY and not words & TRUTH:
        note = (
            "   # computed from the wheel speeds? "
            "Then it shows none of their errors: leave it out"
        )
    sign = ", sign: -1" if signal.startswith(("wheel.fr", "wheel.rr")) else ""
    return f"  {signal}: {{{at}{unit}{sign}}}{note}"


def meanings(header: Sequence[str], row: Sequence[str]) -> list[set[str]]:
    """Return the words of every column; numbered ones are wheels, named by the row or in order."""
    numbered = {name: match for name in header if (match := _NUMBERED.fullmatch(name))}
    texts = dict(zip(header, row, strict=False))
    names: dict[str, str] = {}
    alike: dict[tuple[str, str], list[str]] = {}
    for name, match in numbered.items():
        stem, digit, rest = match.groups()
        alike.setdefault((stem, rest), []).append(digit)
        if name in texts and stem.lower().endswith("name"):
            names[digit] = texts[name]
    found = []
    for name in header:
        words = words_of(name)
        is_of_wheels = words & _OF_WHEELS and not words & {"linear", "angular", *_SEEN}
        if name in numbered and is_of_wheels:
            stem, digit, rest = numbered[name].groups()
            digits = sorted(alike[stem, rest])
            order = _ORDER.get(len(digits), ("",) * len(digits))
            words |= words_of(names.get(digit) or order[digits.index(digit)])
        found.append(words)
    return found


def words_of(name: str) -> set[str]:
    """Return the words of a name, in lower case, and pairs of neighbouring words."""
    words = [word.lower() for word in _WORD.findall(name)]
    return {*words, *("".join(pair) for pair in pairwise(words))}


def _signals(words: set[str], unit: str) -> list[str]:
    """Return the signals that a column with these words may be; `unit` is that of a speed."""
    wheels = next((found for names, found in _WHEELS if words & names), ())
    if not wheels and words & _OF_WHEELS:
        wheels = next((found for name, found in _INITIALS.items() if name in words), ())
    if words & _SEEN:
        return []
    if wheels:
        for names, quantity in ((SENT, "setpoint_rpm"), (_DUTY, "duty_pct")):
            if words & names:
                return [f"wheel.{wheel}.{quantity}" for wheel in wheels]
        if words & _OTHER:
            return []
        is_angle = words & {*_COUNTS, *_ANGLE} and not words & _SPEED and not unit
        quantity = "angle_rad" if is_angle else "speed_rpm"
        return [f"wheel.{wheel}.{quantity}" for wheel in wheels]
    for signal, needed, without in _RULES:
        if all(words & some for some in needed) and not words & without:
            return [signal] if signal else []
    return []


def _unit(name: str, signal: str) -> str:
    """Return the unit at the end of a column's name, as part of a line; or nothing."""
    unit = unit_in_name(name, mapped_units()[signal])
    return "" if unit is None or unit == mapped_units()[signal] else f", unit: {unit}"


def quoted(name: str) -> str:
    """Return a name in valid YAML."""
    if re.fullmatch(r"[A-Za-z_][\w.]*", name):
        return name
    escaped = name.replace('"', '\\"')
    return f'"{escaped}"'
