"""A mapping file for a foreign log, guessed from the names of its columns."""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Final

from hilserver.errors import LogError
from hilserver.logs.csv_times import utc_ns
from hilserver.measured.channels import GYRO, NAV_X, NAV_Y, VOLTAGE, YAW
from hilserver.measured.mapping import DATED
from hilserver.measured.names import mapped_units, unit_in_name

FILE: Final = "mapping.yaml"
_WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_WHEELS: Final = (
    ({"fl", "frontleft", "leftfront"}, ("fl",)),
    ({"rl", "rearleft", "leftrear", "bl"}, ("rl",)),
    ({"fr", "frontright", "rightfront"}, ("fr",)),
    ({"rr", "rearright", "rightrear", "br"}, ("rr",)),
    ({"left", "l"}, ("fl", "rl")),
    ({"right", "r"}, ("fr", "rr")),
)
_TIMES: Final = {"t", "time", "timestamp", "stamp", "secs", "seconds", "nsecs"}
_TIME_UNITS: Final = {"ms": "ms", "us": "us", "ns": "ns", "nsecs": "ns"}
_TIME_DIGITS: Final = {
    19: "ns",
    16: "us",
    13: "ms",
}  # of whole numbers counted from 1970
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
}
"""Other quantities of a wheel, for which there is no signal."""
ODOMETRY: Final = {"odom", "odometry", "wheelodom"}
_NUMBERED: Final = re.compile(r"(.*?)\[?(\d)\]?(\D*)")
_OF_WHEELS: Final = {*_SPEED, *_COUNTS, *_ANGLE, *_DUTY, "wheel", "motor", "joint"}
_ORDER: Final = {2: ("left", "right"), 4: ("fl", "fr", "rl", "rr")}
_TURN: Final = {"yaw", "theta", "heading", "psi"}
_GYRO: Final = {"gyro", "yawrate", "wz", "gz", "imu"}
_VOLTAGE: Final = {"voltage", "battery", "vbat", "volt"}


class ForeignLog(LogError):
    """A log without any of our signals."""

    def __init__(self, message: str, proposal: str) -> None:
        super().__init__(message)
        self.proposal = (
            proposal  # text of a mapping file that may fit; empty without a guess
        )


def propose(header: Sequence[str], row: Sequence[str] = ()) -> str:
    """Return the text of a mapping file for a table with these columns; empty without a guess.

    Parameters
    ----------
    row : sequence of str
        The first row: it holds the names of joints if columns are numbered.
    """
    time = ""
    channels: dict[str, str] = {}
    for name, words in zip(header, meanings(header, row), strict=True):
        if not time and words & _TIMES:
            first = dict(zip(header, row, strict=False)).get(name, "").strip()
            unit = _TIME_DIGITS.get(len(first) if first.isdecimal() else 0, "s")
            unit = next((u for word, u in _TIME_UNITS.items() if word in words), unit)
            unit = DATED if _is_date(first) else unit
            time = f"time: {{column: {quoted(name)}, unit: {unit}}}"
            continue
        for signal, at in lines(name, words, f"column: {quoted(name)}"):
            channels.setdefault(signal, at)
    return text(
        channels,
        time
        or "time: {rate_hz: 50}   # no time column was recognised: write the row rate",
    )


def text(channels: Mapping[str, str], *time: str) -> str:
    """Return a mapping file with the lines of its channels; empty without a channel."""
    if not channels:
        return ""
    parts = [
        "# Guessed from names: check every line, especially units and signs.",
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


def _is_date(text: str) -> bool:
    return not text.isdecimal() and utc_ns(text) is not None


def line(signal: str, name: str, words: set[str], at: str) -> str:
    """Return the line of a signal `at` a column, or topic and field."""
    unit, note = _unit(name, signal), ""
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
    elif signal.startswith("nav.") and words & ODOMETRY:
        note = (
            "   # computed from the wheel speeds? "
            "Then it shows none of their errors: leave it out"
        )
    sign = ", sign: -1" if signal.startswith(("wheel.fr", "wheel.rr")) else ""
    return f"  {signal}: {{{at}{unit}{sign}}}{note}"


def meanings(header: Sequence[str], row: Sequence[str]) -> list[set[str]]:
    """Return the words of every column; numbered ones are wheels, named by the row or in order."""
    numbered = {name: match for name in header if (match := _NUMBERED.fullmatch(name))}
    names = {
        numbered[name][2]: text
        for name, text in zip(header, row, strict=False)
        if name in numbered and numbered[name][1].lower().endswith("name")
    }
    alike: dict[tuple[str, str], list[str]] = {}
    for match in numbered.values():
        alike.setdefault((match[1], match[3]), []).append(match[2])
    found = []
    for name in header:
        words = words_of(name)
        if name in numbered and words & _OF_WHEELS:
            match = numbered[name]
            digits = sorted(alike[match[1], match[3]])
            order = _ORDER.get(len(digits), ("",) * len(digits))
            words |= words_of(names.get(match[2]) or order[digits.index(match[2])])
        found.append(words)
    return found


def words_of(name: str) -> set[str]:
    """Return the words of a name, in lower case, and pairs of neighbouring words."""
    words = [word.lower() for word in _WORD.findall(name)]
    return {*words, *("".join(pair) for pair in pairwise(words))}


def _signals(words: set[str], unit: str) -> list[str]:
    """Return the signals that a column with these words may be; `unit` is that of a speed."""
    wheels = next((found for names, found in _WHEELS if words & names), ())
    if wheels:
        for names, quantity in ((SENT, "setpoint_rpm"), (_DUTY, "duty_pct")):
            if words & names:
                return [f"wheel.{wheel}.{quantity}" for wheel in wheels]
        if words & _OTHER:
            return []
        is_angle = words & {*_COUNTS, *_ANGLE} and not words & _SPEED and not unit
        return [
            f"wheel.{wheel}.{'angle_rad' if is_angle else 'speed_rpm'}"
            for wheel in wheels
        ]
    if words & SENT and words & {"linear", "v", "x"}:
        return ["twist.linear_m_s"]
    if words & SENT and words & {"angular", "w", "z", "omega"}:
        return ["twist.angular_rad_s"]
    if words & _GYRO and not words & {"accel", "acc", "x", "y"}:
        return [GYRO]
    if words & _TURN:
        return [YAW]
    if words & _VOLTAGE:
        return [VOLTAGE]
    if words & {"x", "px", "posx"}:
        return [NAV_X]
    return [NAV_Y] if words & {"y", "py", "posy"} else []


def _unit(name: str, signal: str) -> str:
    """Return the unit at the end of a column's name, as part of a line; or nothing."""
    unit = unit_in_name(name, mapped_units()[signal])
    return "" if unit is None or unit == mapped_units()[signal] else f", unit: {unit}"


def quoted(name: str) -> str:
    """Return a name in valid YAML."""
    return (
        name
        if re.fullmatch(r"[A-Za-z_][\w.]*", name)
        else '"' + name.replace('"', '\\"') + '"'
    )
