"""A controller as yours might be: turns the robot to a heading and keeps it there."""

import math
from dataclasses import dataclass

MAX_TURN_RAD_S = 1.0
GAIN_PER_S = 2.5


@dataclass
class HeadingController:
    """Commands a turn rate from the heading that the robot reports."""

    target_rad: float

    def cycle(self, yaw_rad: float) -> dict[str, float]:
        """Return what is sent to the robot in this cycle (every 20 ms)."""
        error_rad = math.remainder(self.target_rad - yaw_rad, 2 * math.pi)
        turn_rad_s = max(-MAX_TURN_RAD_S, min(GAIN_PER_S * error_rad, MAX_TURN_RAD_S))
        return {
            "control.mode": 1,
            "twist.linear_m_s": 0.0,
            "twist.angular_rad_s": turn_rad_s,
        }
