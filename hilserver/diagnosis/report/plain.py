"""Names of signals in a technician's words: a headline contains no ``wheel.fl.speed_rpm``."""

import re
from typing import Final

from hilserver.plant.layout import WHEEL_WORDS
from hilserver.signals import MEASURED, Ranges, robot_table

_WORDS: Final = {
    "t_s": "time",
    "pose.yaw_rad": "the heading",
    "pose.x_m": "the position x",
    "pose.y_m": "the position y",
    "velocity.linear_m_s": "the forward speed",
    "velocity.lateral_m_s": "the sideways speed",
    "velocity.angular_rad_s": "the turn rate",
    "twist.linear_m_s": "the commanded forward speed",
    "twist.angular_rad_s": "the commanded turn rate",
    "imu.gyro_z_rad_s": "the gyro",
    "imu.yaw_rad": "the IMU's heading",
    "imu.accel_x_m_s2": "the forward acceleration",
    "imu.accel_y_m_s2": "the sideways acceleration",
    "battery.voltage_v": "the battery voltage",
    "nav.x_m": "the navigation's x position",
    "nav.y_m": "the navigation's y position",
    "nav.yaw_rad": "the navigation's heading",
    "input.sequence": "the controller's counter",
}
_OF_WHEELS: Final = {
    "speed_rpm": ("speed", "speeds"),
    "duty_pct": ("duty", "duties"),
    "setpoint_rpm": ("set-point", "set-points"),
    "angle_rad": ("angle", "angles"),
}
_ALL_FROM: Final = 3  # this many wheels in a row are called the wheels

_WHEEL = r"wheel\.(?:fl|rl|fr|rr)\.(\w+)"
_RUN = re.compile(
    rf"{_WHEEL}(?:(?:, | and )wheel\.(?:fl|rl|fr|rr)\.\1\b)*(?P<more> and \d+ more)?"
)
_CYCLE = re.compile(r"t_s mod (\d+(?:\.\d+)?(?:e[+-]?\d+)?)")
_GROUPS: Final = {s.name.partition(".")[0] for s in robot_table(Ranges(1.0, 1.0, 1.0))}
_NAME = re.compile(
    rf"\b(?:t_s|(?:{'|'.join(sorted(_GROUPS))})(?:\.[a-z][a-z0-9_]*)+)\b"
)
_UNIT = re.compile(r"_(?:rpm|pct|rad|m|v|a|c|s|nm|n)(?:_s2?)?$")


def plain(text: str) -> str:
    """Return `text` with words for the names of signals, and a capital first letter."""
    text = _RUN.sub(_wheels, _CYCLE.sub(r"a cycle of \1 s", text))
    text = _NAME.sub(_signal, text)
    return text[:1].upper() + text[1:]


def _wheels(run: re.Match[str]) -> str:
    one, several = _OF_WHEELS.get(run[1]) or 2 * (_words(run[1]),)
    places = re.findall(r"wheel\.(\w\w)\.", run[0])
    if len(places) >= _ALL_FROM or run["more"]:
        return f"the {several} of the wheels"
    words = " and ".join(WHEEL_WORDS[place] for place in dict.fromkeys(places))
    return f"the {one} of the {words} wheel{'s' * (len(places) > 1)}"


def _signal(match: re.Match[str]) -> str:
    name = match[0].removeprefix(MEASURED)
    if name in _WORDS:
        return _WORDS[name]
    group, _, rest = name.partition(".")
    if group == "tof":
        return f"the range finder {WHEEL_WORDS.get(rest[:2], rest)}"
    return f"the {_words(name)}"


def _words(name: str) -> str:
    return _UNIT.sub("", name).replace(".", " ").replace("_", " ")
