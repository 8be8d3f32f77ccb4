"""From messages of the host to values for the input gate; each function handles one topic.

A message that requests nothing gives an empty mapping; one that does not fit raises a ValueError
with one sentence.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from hilserver.plant.layout import WHEELS
from hilserver.ros import outgoing
from hilserver.ros.robot import RosFrame
from hilserver.signals import LIGHTS

Values = dict[str, object]
FIRST_LIGHT: Final = 0x42
AMBER, WHITE, BLUE, RED = (255, 0x88, 0), (255, 255, 255), (0, 0, 255), (255, 0, 0)
BUTTONS: Final[Mapping[int, tuple[str, tuple[int, int, int]]]] = {
    0: ("high beam", WHITE),
    1: ("flash all", AMBER),
    4: ("flash left", AMBER),
    5: ("flash right", AMBER),
    8: ("rotation", BLUE),
    9: ("running", RED),
}
"""Lights that buttons of a gamepad switch."""
ENABLE_BUTTON: Final = 10
AXES: Final = {"forward": 1, "left": 0, "turn": 3, "throttle": 5}
"""As read from ``joy_extended`` by the real motion node."""
MOVING: Final = frozenset(
    {
        "control.mode",
        "wheels.setpoints_rpm",
        "twist.linear_m_s",
        "twist.lateral_m_s",
        "twist.angular_rad_s",
    }
)
"""Values that move the robot; the rest of a message are lights and enable."""
LIGHTING_MODES: Final = ("off", "dim", "flash all", "pulsation", "rotation", "running")
"""edu_robot's modes of a lighting."""


def _lights(pattern: str, red: int, green: int, blue: int) -> Values:
    colours = {"lights.red": red, "lights.green": green, "lights.blue": blue}
    return {"lights.command": LIGHTS.index(pattern), **colours}


def _speeds(by_wheel: Mapping[str, float]) -> Values:
    return {
        "control.mode": 0,
        "wheels.setpoints_rpm": [float(by_wheel[wheel]) for wheel in WHEELS],
    }


def rpm(robot: RosFrame, message: Any) -> Values:
    """RotationSpeed: set-points with the signs of the plant."""
    del robot
    return _speeds(
        {
            wheel: getattr(message, f"{place}_rpm")
            for wheel, place in outgoing.PLACES.items()
        }
    )


def _four(message: Any) -> Sequence[float]:
    if len(message.data) != len(WHEELS):
        raise ValueError(
            f"{len(message.data)} numbers instead of one for each of four wheels"
        )
    return [float(number) for number in message.data]


def rpm_thesis(robot: RosFrame, message: Any) -> Values:
    """Float32MultiArray in the configured order, with the signs of the plant."""
    return _speeds(dict(zip(robot.array_order, _four(message), strict=True)))


def motor_rpm(robot: RosFrame, message: Any) -> Values:
    """Float32MultiArray with the order and signs of edu_robot."""
    del robot
    return _speeds(
        {w: -speed for w, speed in zip(outgoing.MOTORS, _four(message), strict=True)}
    )


def velocity(robot: RosFrame, message: Any) -> Values:
    """Twist: scaled down as a whole if it exceeds the limits of the robot."""
    return _twist(robot, message.linear.x, message.linear.y, message.angular.z)


def stamped(robot: RosFrame, message: Any) -> Values:
    """TwistStamped: counts from its arrival, as the clock of its writer may be another one."""
    return velocity(robot, message.twist)


def _twist(robot: RosFrame, forward: float, left: float, turn: float) -> Values:
    shape = robot.shape
    if shape.max_lateral_m_s == 0.0 and left:
        robot.ignore("lateral")
        left = 0.0
    shares = [forward / shape.max_linear_m_s, turn / shape.max_angular_rad_s]
    largest = max(
        abs(share) for share in [*shares, left / (shape.max_lateral_m_s or 1.0)]
    )
    factor = 1.0 / largest if math.isfinite(largest) and largest > 1.0 else 1.0
    return {
        "control.mode": 1,
        "twist.linear_m_s": forward * factor,
        "twist.lateral_m_s": left * factor,
        "twist.angular_rad_s": turn * factor,
    }


def when_remote(robot: RosFrame, message: Any) -> Values:
    """Twist while edu_robot is driven by hand."""
    return {} if robot.autonomous else velocity(robot, message)


def when_autonomous(robot: RosFrame, message: Any) -> Values:
    """Twist while edu_robot drives by itself."""
    return velocity(robot, message) if robot.autonomous else {}


def axes(robot: RosFrame, message: Any) -> Values:
    """Joy: the axes as the real motion node reads them."""
    robot.extended_axes = True
    return _axes(robot, message)


def _axes(robot: RosFrame, message: Any) -> Values:
    if len(message.axes) <= max(AXES.values()):
        raise ValueError(
            f"a Joy with {len(message.axes)} axes; driving takes axes 0, 1, 3 and 5"
        )
    at = {name: float(message.axes[number]) for name, number in AXES.items()}
    throttle, shape = 0.5 * (at["throttle"] + 1.0), robot.shape
    return _twist(
        robot,
        throttle * at["forward"] * shape.max_linear_m_s,
        throttle * at["left"] * shape.max_lateral_m_s,
        throttle * at["turn"] * shape.max_angular_rad_s,
    )


def gamepad(robot: RosFrame, message: Any) -> Values:
    """Joy: lights and enable at edges of buttons; axes, unless they come by ``joy_extended``."""
    buttons = [int(button) for button in message.buttons]
    before = robot.buttons + [0] * (len(buttons) - len(robot.buttons))
    pressed = {i for i, now in enumerate(buttons) if now and not before[i]}
    robot.buttons = buttons
    values: Values = {}
    for number, (pattern, colour) in BUTTONS.items():
        if number in pressed:
            values |= _lights(pattern, *colour)
    if ENABLE_BUTTON in pressed:
        values["drive.enable"] = True
    if robot.extended_axes or len(message.axes) <= max(AXES.values()):
        return values
    return values | _axes(robot, message)


def is_at_rest(values: Values) -> bool:
    """Whether values ask every wheel to stand; False if they ask nothing of the wheels."""
    asked = [values[name] for name in MOVING - {"control.mode"} if name in values]
    numbers = [n for one in asked for n in (one if isinstance(one, list) else [one])]
    return bool(numbers) and not any(numbers)


def lights_color(robot: RosFrame, message: Any) -> Values:
    """Int16: the shield's code of a light pattern (0x42 ...) or its number from 0 on."""
    del robot
    return {"lights.command": _pattern(int(message.data))}


def _pattern(code: int) -> int:
    number = code - FIRST_LIGHT if code >= FIRST_LIGHT else code
    if not 0 <= number < len(LIGHTS):
        last = FIRST_LIGHT + len(LIGHTS) - 1
        raise ValueError(
            f"light pattern {code} is not 0 .. 8 or {FIRST_LIGHT} .. {last}"
        )
    return number


def lighting(robot: RosFrame, message: Any) -> Values:
    """SetLightingColor of edu_robot."""
    if message.mode >= len(LIGHTING_MODES):
        raise ValueError(f"there is no lighting mode {message.mode}")
    pattern = LIGHTING_MODES[message.mode]
    side = next(
        (side for side in ("left", "right") if side in message.lighting_name), None
    )
    if pattern == "flash all" and side is not None:
        pattern = f"flash {side}"
    elif message.lighting_name != "all" and side is None:
        robot.ignore(f"lighting {message.lighting_name}")
    bright = min(max(float(message.brightness.data), 0.0), 1.0)
    red, green, blue = (
        round(bright * value) for value in (message.r, message.g, message.b)
    )
    return _lights(pattern, red, green, blue)


# --- services: request to values and response -----------------------------------------------------

Answer = tuple[Values, Callable[[bool], Any]]
"""Values to write, and a function that makes the response once the gate has decided."""


def _sent(robot: RosFrame, service: str) -> Callable[[bool], Any]:
    return lambda ok: robot.make(
        f"iotbot_interface/srv/{service}_Response", sending_succesfull=ok
    )


def send_enable(robot: RosFrame, request: Any) -> Answer:
    """Enable or disable the drive."""
    return {"drive.enable": bool(request.enable)}, _sent(robot, "SendEnable")


def send_lighting(robot: RosFrame, request: Any) -> Answer:
    """Set pattern and colour."""
    answer = _sent(robot, "SendLighting")
    try:
        pattern = LIGHTS[_pattern(int(request.command))]
    except ValueError:
        return {}, lambda _: answer(False)
    return _lights(
        pattern, int(request.red), int(request.green), int(request.blue)
    ), answer


def send_imu_mode(robot: RosFrame, request: Any) -> Answer:
    """Raw data instead of an orientation."""
    robot.imu_is_raw = bool(request.enable)
    return {}, _sent(robot, "SendEnable")


def send_imu_calibration(robot: RosFrame, request: Any) -> Answer:
    """Accept; there is nothing to calibrate."""
    del request
    robot.ignore("imu calibration")
    return {}, lambda _: robot.make("std_srvs/srv/Empty_Response")


def set_mode(robot: RosFrame, request: Any) -> Answer:
    """Mode of edu_robot: inactive disables the drive."""
    wanted, values = int(request.mode.mode), Values()
    if wanted in (outgoing.MODE_REMOTE, outgoing.MODE_AUTONOMOUS):
        robot.autonomous = wanted == outgoing.MODE_AUTONOMOUS
        values = {"drive.enable": True}
    elif wanted:
        values = {"drive.enable": False}
    if request.mode.feature_mode or request.disable_feature:
        robot.ignore("feature mode")

    def answer(ok: bool) -> Any:
        now = dict(robot.values)
        if ok and values:
            now["drive.enable"] = float(values["drive.enable"])  # type: ignore[arg-type]
        robot.values = now
        known = outgoing.state(robot, "OK" if ok else "REJECTED")
        return robot.make("edu_robot/srv/SetMode_Response", state=known)

    return values, answer


def reset_odometry(robot: RosFrame, request: Any) -> Answer:
    """Count the position from here on."""
    del request
    robot.odometer.reset()
    text = "odometry was reset successfully"
    kind = "std_srvs/srv/Trigger_Response"
    return {}, lambda _: robot.make(kind, success=True, message=text)
