"""The rows of the table: every signal of the robot, named once.

A new signal is a new row here; its slots follow from its place.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from hilserver.plant.layout import (
    COMMAND_NORMAL,
    COMMAND_SAFE,
    COMMAND_ZERO,
    CORNERS,
    WHEEL_WORDS,
    WHEELS,
)
from hilserver.signals.table import Direction, Signal, SignalTable, ValueType
from hilserver.signals.vocabulary import (
    COLOURS,
    ESTIMATE_STATES,
    LIGHTS,
    MEASURED,
    SAMPLED,
    State,
)

_Row = tuple[str, str, float, float, str]
"""Name, unit, lowest and highest value, description."""


@dataclass(frozen=True, slots=True)
class Ranges:
    """The limits that determine the ranges of a robot's signals."""

    max_rpm: float
    max_linear_m_s: float
    max_angular_rad_s: float
    max_lateral_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class BlockOutput:
    """An output of a user's block, as the table needs it."""

    name: str
    unit: str
    low: float
    high: float
    description: str
    is_replayed: bool = False


class _Builder:
    """Assigns slots in the order of the calls."""

    def __init__(self) -> None:
        self.signals: list[Signal] = []
        self.next_slot = 0

    def add(
        self,
        name: str,
        unit: str,
        direction: Direction,
        low: float,
        high: float,
        description: str,
        *,
        type_: ValueType = ValueType.DOUBLE,
        initial: float = 0.0,
        labels: tuple[str, ...] = (),
        hidden: bool = False,
        is_own: bool = False,
    ) -> None:
        slots = (self.next_slot,)
        self.next_slot += 1
        self.signals.append(
            Signal(
                name,
                unit,
                type_,
                direction,
                low,
                high,
                description,
                slots,
                initial,
                labels,
                hidden,
                is_own,
            )
        )

    def alias(self, name: str, scalars: Iterable[str], description: str) -> None:
        parts = [
            next(s for s in self.signals if s.name == scalar) for scalar in scalars
        ]
        slots = tuple(part.slots[0] for part in parts)
        self.signals.append(
            replace(parts[0], name=name, description=description, slots=slots)
        )


def _add_light_commands(b: _Builder) -> None:
    in_ = Direction.IN
    byte = ValueType.BYTE
    text = f"Light pattern: {', '.join(f'{i} {name}' for i, name in enumerate(LIGHTS))}"
    b.add(
        "lights.command", "1", in_, 0, len(LIGHTS) - 1, text, type_=byte, labels=LIGHTS
    )
    for colour in COLOURS:
        b.add(
            f"lights.{colour}", "1", in_, 0, 255, f"Light colour, {colour}", type_=byte
        )


def _add_inputs(b: _Builder, ranges: Ranges) -> None:
    in_ = Direction.IN
    for wheel in WHEELS:
        b.add(
            f"wheel.{wheel}.setpoint_rpm",
            "rpm",
            in_,
            -ranges.max_rpm,
            ranges.max_rpm,
            f"Set-point of the {wheel} wheel; right wheels are mirrored: forward is negative",
        )
    linear = ranges.max_linear_m_s
    angular = ranges.max_angular_rad_s
    b.add("twist.linear_m_s", "m/s", in_, -linear, linear, "Commanded forward speed")
    b.add(
        "twist.angular_rad_s",
        "rad/s",
        in_,
        -angular,
        angular,
        "Commanded turn rate, left +",
    )
    lateral = ranges.max_lateral_m_s
    text = "Commanded sideways speed, left +; skid steering: only 0"
    b.add("twist.lateral_m_s", "m/s", in_, 0.0 - lateral, lateral, text)
    for wheel in WHEELS:
        text = f"Duty of the {wheel} wheel straight to the process, bypassing the speed controller"
        b.add(f"wheel.{wheel}.duty_command_pct", "%", in_, -100.0, 100.0, text)
    byte = ValueType.BYTE
    boolean = ValueType.BOOLEAN
    modes = ("wheels", "twist", "duty")
    enabled = ("disabled", "enabled")
    text = "0 wheel set-points, 1 twist, 2 wheel duties"
    b.add("control.mode", "1", in_, 0, len(modes) - 1, text, type_=byte, labels=modes)
    text = "Drive enabled"
    b.add(
        "drive.enable", "1", in_, 0, 1, text, type_=boolean, initial=1.0, labels=enabled
    )
    _add_light_commands(b)
    b.add(
        "input.sequence",
        "1",
        in_,
        0,
        2**32 - 1,
        "The controller's counter",
        type_=ValueType.UINT32,
    )


def _add_hidden(b: _Builder) -> None:
    in_ = Direction.IN
    commands = f"{COMMAND_NORMAL} normal, {COMMAND_ZERO} zero, {COMMAND_SAFE} safe ramp"
    b.add(
        "internal.command",
        "1",
        in_,
        COMMAND_NORMAL,
        COMMAND_SAFE,
        commands,
        hidden=True,
    )
    b.add(
        "internal.pose_request", "1", in_, 0, 2**53, "Counter of SetPose", hidden=True
    )
    b.add("internal.pose_x_m", "m", in_, -1e6, 1e6, "SetPose x", hidden=True)
    b.add("internal.pose_y_m", "m", in_, -1e6, 1e6, "SetPose y", hidden=True)
    b.add(
        "internal.pose_yaw_rad",
        "rad",
        in_,
        -math.pi,
        math.pi,
        "SetPose yaw",
        hidden=True,
    )
    b.add(
        "internal.gains",
        "1",
        in_,
        0,
        1,
        "1: the shield's host sets the gains",
        hidden=True,
    )
    b.add(
        "internal.k_p", "1", in_, 0, 1e4, "Gain that the shield's host set", hidden=True
    )
    b.add(
        "internal.k_i", "1", in_, 0, 1e6, "Gain that the shield's host set", hidden=True
    )


_MOTION: Final[list[_Row]] = [
    ("pose.x_m", "m", -1e6, 1e6, "Position of the centre of mass, world frame"),
    ("pose.y_m", "m", -1e6, 1e6, "Position of the centre of mass, world frame"),
    (
        "pose.yaw_rad",
        "rad",
        -math.pi,
        math.pi,
        "Heading, counter-clockwise positive",
    ),
    ("velocity.linear_m_s", "m/s", -10.0, 10.0, "Forward velocity, body frame"),
    (
        "velocity.lateral_m_s",
        "m/s",
        -10.0,
        10.0,
        "Lateral velocity, body frame, left +",
    ),
    (
        "velocity.angular_rad_s",
        "rad/s",
        -50.0,
        50.0,
        "Yaw rate, counter-clockwise +",
    ),
    ("imu.gyro_z_rad_s", "rad/s", -50.0, 50.0, "Gyroscope, z axis"),
    ("imu.yaw_rad", "rad", -math.pi, math.pi, "Yaw of the IMU"),
    (
        "imu.accel_x_m_s2",
        "m/s²",
        -500.0,
        500.0,
        "Acceleration of the centre of mass, forward",
    ),
    (
        "imu.accel_y_m_s2",
        "m/s²",
        -500.0,
        500.0,
        "Acceleration of the centre of mass, left",
    ),
    ("battery.voltage_v", "V", 0.0, 30.0, "Battery voltage"),
]
_SLOW_SENSORS: Final[list[_Row]] = [
    ("nav.x_m", "m", -1e6, 1e6, "Navigation tag, position"),
    ("nav.y_m", "m", -1e6, 1e6, "Navigation tag, position"),
    ("nav.yaw_rad", "rad", -math.pi, math.pi, "Navigation tag, heading"),
    (
        "battery.current_a",
        "A",
        0.0,
        50.0,
        "Current that the robot draws from the battery",
    ),
    ("shield.temperature_degc", "°C", -40.0, 125.0, "Temperature of the shield"),
]


def _robot_outputs() -> list[_Row]:
    rows: list[_Row] = []
    for wheel in WHEELS:
        text = f"Measured speed of the {wheel} wheel, as seen by the controller"
        rows.append((f"wheel.{wheel}.speed_rpm", "rpm", -200.0, 200.0, text))
    rows += [
        (
            f"wheel.{w}.duty_pct",
            "%",
            -100.0,
            100.0,
            f"Controller output of the {w} wheel, PWM duty",
        )
        for w in WHEELS
    ]
    rows += [
        (
            f"wheel.{w}.angle_rad",
            "rad",
            -1e9,
            1e9,
            f"Angle of the {w} wheel since reset",
        )
        for w in WHEELS
    ]
    rows += _MOTION
    rows += [
        (
            f"tof.{place}_m",
            "m",
            0.0,
            5.0,
            f"Range finder {place}; 5.0 and Uncertain: nothing seen",
        )
        for place in CORNERS
    ]
    rows += _SLOW_SENSORS
    return rows


def _add_lights(b: _Builder) -> None:
    out = Direction.OUT
    byte = ValueType.BYTE
    text = "Light pattern shown"
    b.add("lights.state", "1", out, 0, len(LIGHTS) - 1, text, type_=byte, labels=LIGHTS)
    for place in CORNERS:
        for colour in COLOURS:
            text = f"Lamp {place} as it blinks, {colour}"
            b.add(f"lights.{place}.{colour}", "1", out, 0, 255, text, type_=byte)


def _add_demands(b: _Builder, max_rpm: float) -> None:
    """Add what the wheels are asked to do, whoever drives.

    The real robot's is ``measured.wheel.<w>.setpoint_rpm``.
    """
    text = "Speed asked of the {} wheel, whoever drives: after inverse kinematics, limits, delay"
    for wheel in WHEELS:
        what = text.format(WHEEL_WORDS[wheel])
        b.add(
            f"wheel.{wheel}.demand_rpm", "rpm", Direction.OUT, -max_rpm, max_rpm, what
        )


_BODY_MOTION: Final[list[_Row]] = [
    (
        "mech.x_m",
        "m",
        -1e6,
        1e6,
        "Position of the body's centre of mass, world frame",
    ),
    (
        "mech.y_m",
        "m",
        -1e6,
        1e6,
        "Position of the body's centre of mass, world frame",
    ),
    (
        "mech.z_m",
        "m",
        -1e6,
        1e6,
        "Height of the body's centre of mass above the floor",
    ),
    (
        "mech.roll_rad",
        "rad",
        -math.pi,
        math.pi,
        "Roll of the body, right side down +",
    ),
    ("mech.pitch_rad", "rad", -math.pi, math.pi, "Pitch of the body, nose down +"),
    (
        "mech.yaw_rad",
        "rad",
        -math.pi,
        math.pi,
        "Heading of the body, counter-clockwise +",
    ),
    ("mech.linear_m_s", "m/s", -100.0, 100.0, "Forward velocity of the body"),
    (
        "mech.lateral_m_s",
        "m/s",
        -100.0,
        100.0,
        "Lateral velocity of the body, left +",
    ),
    (
        "mech.angular_rad_s",
        "rad/s",
        -500.0,
        500.0,
        "Yaw rate of the body, counter-clockwise +",
    ),
]
_BODY_BESIDE_POSE: Final[list[_Row]] = [
    (
        "mech.gap_m",
        "m",
        0.0,
        1e6,
        "Distance between the body and the kinematic pose",
    ),
    (
        "mech.gap_yaw_rad",
        "rad",
        -math.pi,
        math.pi,
        "Heading of the body minus the kinematic one",
    ),
    (
        "mech.contact",
        "1",
        0.0,
        1.0,
        "1 while the chassis touches a wall, a box or the floor",
    ),
]


def _body_outputs() -> list[_Row]:
    """Return the outputs of the mechatronic model, in the order of `hilserver.body.layout`."""
    rows = list(_BODY_MOTION)
    rows += [
        (f"mech.tof.{place}_m", "m", 0.0, 5.0, f"Range finder {place} of the body")
        for place in CORNERS
    ]
    rows += [
        (
            f"mech.imu.gyro_{axis}_rad_s",
            "rad/s",
            -500.0,
            500.0,
            f"Gyroscope of the body, {axis}",
        )
        for axis in "xyz"
    ]
    text = "Specific force of the body, +9.81 in z at rest"
    rows += [
        (f"mech.imu.accel_{axis}_m_s2", "m/s²", -5000.0, 5000.0, f"{text}; {axis}")
        for axis in "xyz"
    ]
    for quantity, unit, size, text in (
        ("speed_rpm", "rpm", 10_000.0, "Speed of the {} wheel of the body"),
        ("normal_force_n", "N", 1e6, "Normal force of the floor on the {} wheel"),
        (
            "slip_m_s",
            "m/s",
            100.0,
            "Slip of the {} wheel; forward over the floor is positive",
        ),
        ("torque_nm", "N·m", 1e4, "Torque of the {} drive, mirrored like the speed"),
    ):
        low = 0.0 if unit == "N" else -size
        rows += [
            (f"mech.wheel.{w}.{quantity}", unit, low, size, text.format(WHEEL_WORDS[w]))
            for w in WHEELS
        ]
    return rows + _BODY_BESIDE_POSE


def _add_samples(b: _Builder) -> None:
    """Add counters and times of measured samples, so that two equal samples count as two."""
    for group in SAMPLED:
        text = f"Samples of measured.{group}.*"
        b.add(
            f"internal.samples_{group}", "1", Direction.IN, 0, 2**53, text, hidden=True
        )
        for what, happened in (("time", "came"), ("taken", "was taken by its source")):
            text = f"When the last of measured.{group}.* {happened}, in simulated time"
            b.add(
                f"internal.{what}_{group}_s",
                "s",
                Direction.IN,
                0,
                1e9,
                text,
                hidden=True,
            )


def _add_estimate(b: _Builder) -> None:
    """Add the outputs of the observer, in the order of `hilserver.observer.layout`."""
    out = Direction.OUT
    known = []
    for name, unit, size, text in (
        ("x_m", "m", 1e6, "position of the centre of mass, world frame"),
        ("y_m", "m", 1e6, "position of the centre of mass, world frame"),
        ("yaw_rad", "rad", math.pi, "heading, counter-clockwise +"),
        ("linear_m_s", "m/s", 100.0, "forward velocity"),
        ("angular_rad_s", "rad/s", 500.0, "yaw rate, counter-clockwise +"),
        ("gyro_bias_rad_s", "rad/s", 10.0, "reading of the gyroscope at rest"),
    ):
        known.append(
            (f"{name}_sd", unit, 0.0, 1e6, f"Standard deviation of estimate.{name}")
        )
        b.add(f"estimate.{name}", unit, out, -size, size, f"Observer: {text}")
    for name, unit, low, high, text in known:
        b.add(f"estimate.{name}", unit, out, low, high, text)
    for one, other, unit in (("x", "y", "m²"), ("x", "yaw", "m"), ("y", "yaw", "m")):
        text = f"Covariance of the errors in {one} and {other}"
        b.add(f"estimate.{one}_{other}_cov", unit, out, -1e9, 1e9, text)
    text = "Innovation of the newest sample, squared and normalised by its covariance: 1 on average"
    b.add("estimate.nis", "1", out, 0, 1e12, text)
    text = f"State of the observer: {', '.join(f'{i} {s}' for i, s in enumerate(ESTIMATE_STATES))}"
    last = len(ESTIMATE_STATES) - 1
    byte = ValueType.BYTE
    b.add("estimate.state", "1", out, 0, last, text, type_=byte, labels=ESTIMATE_STATES)
    text = "Navigation samples that were rejected as outliers"
    b.add("estimate.rejected", "1", out, 0, 2**53, text, type_=ValueType.INT64)


def _add_interlock(b: _Builder) -> None:
    """Add an input, so that recordings have it, of which nothing but the daemon decides."""
    b.add(
        "control.waits_for_start",
        "1",
        Direction.IN,
        0,
        1,
        "Automatic sources wait for Start after a safe state; the daemon decides, nobody writes it",
        type_=ValueType.BOOLEAN,
        labels=("no", "waits"),
        is_own=True,
    )


def _add_daemon(b: _Builder) -> None:
    """Add time, tick and state of the daemon."""
    out = Direction.OUT
    b.add(
        "sim.tick",
        "1",
        out,
        0,
        2**53,
        "Tick that made these values",
        type_=ValueType.INT64,
    )
    b.add("sim.time_s", "s", out, 0, 1e9, "Simulated time")
    words = tuple(state.word for state in State)
    last = max(State)
    text = (
        f"State of the daemon: {', '.join(f'{state} {state.word}' for state in State)}"
    )
    b.add("sim.state", "1", out, 0, last, text, type_=ValueType.BYTE, labels=words)
    b.add(
        "internal.state",
        "1",
        Direction.IN,
        0,
        last,
        "State that sim.state shows",
        hidden=True,
    )
    text = "Number of the last parameter change"
    b.add("internal.edition", "1", out, 0, 2**53, text, hidden=True)


def _add_measured(b: _Builder, outputs: Iterable[_Row], max_rpm: float) -> None:
    """Add what a real robot beside this one measures."""
    for name, unit, low, high, text in outputs:
        b.add(f"{MEASURED}{name}", unit, Direction.IN, low, high, f"Real robot: {text}")
    for wheel in WHEELS:
        text = f"Real robot: set-point that its {wheel} wheel currently follows"
        name = f"{MEASURED}wheel.{wheel}.setpoint_rpm"
        b.add(name, "rpm", Direction.IN, -max_rpm, max_rpm, text)


def _add_arrays(b: _Builder) -> None:
    b.alias(
        "wheels.setpoints_rpm",
        [f"wheel.{w}.setpoint_rpm" for w in WHEELS],
        "All set-points",
    )
    b.alias(
        "wheels.speeds_rpm",
        [f"wheel.{w}.speed_rpm" for w in WHEELS],
        "All wheel speeds",
    )


def robot_table(
    ranges: Ranges,
    blocks: Iterable[BlockOutput] = (),
    *,
    body: bool = False,
    observer: bool = False,
    samples: bool = False,
) -> SignalTable:
    """Return the table of the four-wheeled robot, followed by the outputs of own blocks.

    With `body` or `observer`, the outputs of the mechatronic model or the observer come before
    these. Measured samples are counted for an observer, or with `samples`.
    """
    b = _Builder()
    _add_inputs(b, ranges)
    _add_hidden(b)
    outputs = _robot_outputs()
    for name, unit, low, high, text in outputs:
        b.add(name, unit, Direction.OUT, low, high, text)
    _add_lights(b)
    _add_demands(b, ranges.max_rpm)
    _add_daemon(b)
    _add_measured(b, outputs, ranges.max_rpm)
    out = Direction.OUT
    for name, unit, low, high, text in _body_outputs() if body else ():
        b.add(name, unit, out, low, high, text)
    if observer:
        _add_estimate(b)
    if observer or samples:
        _add_samples(b)
    for block in blocks:
        way, hidden = (Direction.IN, True) if block.is_replayed else (out, False)
        b.add(
            block.name,
            block.unit,
            way,
            block.low,
            block.high,
            block.description,
            hidden=hidden,
        )
    _add_interlock(b)  # last: the slots of all others are those of before
    _add_arrays(b)
    return SignalTable(b.signals)
