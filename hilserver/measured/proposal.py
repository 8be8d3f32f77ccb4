"""A mapping file for a foreign table, guessed from the names of its columns."""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from hilserver.errors import LogError
from hilserver.measured.channels import GYRO, NAV_X, NAV_Y, VOLTAGE, YAW
from hilserver.measured.names import conversion, known_signals

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
_SENT: Final = {"setpoint", "set", "cmd", "command", "target", "ref", "desired", "sp", "goal"}
_SPEED: Final = {"speed", "vel", "velocity", "rpm", "omega", "w", "encoder"}
_DUTY: Final = {"duty", "pwm", "effort"}
_TURN: Final = {"yaw", "theta", "heading", "psi"}
_GYRO: Final = {"gyro", "yawrate", "wz", "gz", "imu"}
_VOLTAGE: Final = {"voltage", "battery", "vbat", "volt"}
_UNITS: Final = (
    (r"rad(ps|s|_?p?er_?s|_s)(ec)?(?![a-z])", "rad/s"),
    (r"deg(ps|s|_s|_per_s)(?![a-z])", "deg/s"),
    (r"rpm", "rpm"),
    (r"(?<![a-z])m_?p?s(?![a-z])", "m/s"),
    (r"(?<![a-z])rad(?![a-z])", "rad"),
    (r"(?<![a-z])deg(?![a-z])", "deg"),
    (r"(?<![a-z])(cm|mm|mv)(?![a-z])", ""),
)


class ForeignTable(LogError):
    """A table without any signal of ours, and the mapping file that may fit it.

    Attributes
    ----------
    proposal : str
        Text of a mapping file; empty where no column looks like a signal.
    """

    def __init__(self, path: object, header: Sequence[str]) -> None:
        columns = ", ".join(f"'{name}'" for name in header)
        self.proposal = propose(header)
        super().__init__(
            f"{path}: row 1: none of the columns {columns:.600} is a signal of hilserver; name them"
            " in a mapping file and give it with --mapping"
        )


def propose(header: Sequence[str]) -> str:
    """Return the text of a mapping file for a table with these columns; empty without a guess."""
    time = ""
    channels: dict[str, tuple[str, str]] = {}
    for name in header:
        words = _words(name)
        if not time and words & _TIMES:
            unit = next((u for word, u in _TIME_UNITS.items() if word in words), "s")
            time = f"time: {{column: {_quoted(name)}, unit: {unit}}}"
            continue
        for signal in _signals(words):
            channels.setdefault(signal, (name, _unit(name, signal)))
    if not channels:
        return ""
    lines = [
        "# Guessed from the names of the columns: check every line, above all units and signs.",
        "# Right wheels turn backwards when the robot drives forward: where they count forward as",
        "# positive, 'sign: -1' turns them round.",
        time or "time: {rate_hz: 50}   # no column of times was seen: write the rate of the rows",
        "channels:",
    ]
    for signal in sorted(channels):
        name, unit = channels[signal]
        sign = ", sign: -1" if signal.startswith(("wheel.fr", "wheel.rr")) else ""
        lines.append(f"  {signal}: {{column: {_quoted(name)}{unit}{sign}}}")
    return "\n".join(lines) + "\n"


def _words(name: str) -> set[str]:
    words = [word.lower() for word in _WORD.findall(name)]
    return {*words, *("".join(pair) for pair in pairwise(words))}


def _signals(words: set[str]) -> list[str]:
    """Return the signals that a column with these words may be."""
    wheels = next((found for names, found in _WHEELS if words & names), ())
    if wheels:
        for names, quantity in ((_SENT, "setpoint_rpm"), (_DUTY, "duty_pct")):
            if words & names:
                return [f"wheel.{wheel}.{quantity}" for wheel in wheels]
        return [f"wheel.{wheel}.speed_rpm" for wheel in wheels]
    if words & _SENT and words & {"linear", "v", "x"}:
        return ["twist.linear_m_s"]
    if words & _SENT and words & {"angular", "w", "z", "omega"}:
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
    """Return the unit that the name of a column ends in, as part of a line; or nothing."""
    wanted = known_signals()[signal].unit
    for pattern, meant in _UNITS:
        found = re.search(pattern, name.lower())
        unit = meant or (found[0].replace("mv", "mV") if found else "")
        if found and unit != wanted and conversion(unit, wanted) is not None:
            return f", unit: {unit}"
    return ""


def _quoted(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z_][\w.]*", name) else '"' + name.replace('"', '\\"') + '"'
