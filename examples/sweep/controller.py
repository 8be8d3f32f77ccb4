"""A wheel controller as yours might be, with a defect: it has no integral part.

It commands the duty of each wheel: what the nominal robot needs for the speed, and a correction in
proportion to what is missing. On the bench that looks fine. On a robot with more friction the
correction only works while something is missing, so the robot stays too slow.
"""

SPEED_RPM = 30.0
NEEDED_PCT_PER_RPM = 1.0 / 1.11  # of the nominal robot
GAIN_PCT_PER_RPM = 0.5
# the right wheels are mounted mirrored
SIDES = {"fl": 1.0, "rl": 1.0, "fr": -1.0, "rr": -1.0}


class Controller:
    """Made anew for every machine; called every 20 ms with the time and the signals."""

    def __call__(self, _time_s, signals):
        """Return the commands: duties, in the mode that takes them."""
        commands = {"control.mode": 2}
        for wheel, side in SIDES.items():
            wanted_rpm = side * SPEED_RPM
            missing_rpm = wanted_rpm - signals[f"wheel.{wheel}.speed_rpm"]
            duty_pct = NEEDED_PCT_PER_RPM * wanted_rpm + GAIN_PCT_PER_RPM * missing_rpm
            commands[f"wheel.{wheel}.duty_command_pct"] = max(
                -100.0, min(duty_pct, 100.0)
            )
        return commands
