"""Files for other programs: what was found, with its interval and where it was fitted."""

import csv
import io
import json
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from math import hypot
from typing import Final

from hilserver.exchange.geometry import HELD, DriveGeometry, for_simulator, patched
from hilserver.exchange.ros2_control import PROJECTION, differential_text, mecanum_text
from hilserver.exchange.urdf import sdf_text, urdf_text
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.terms import TERMS
from hilserver.plant.units import RAD_S_PER_RPM


@dataclass(frozen=True, slots=True)
class FoundTerm:
    """A term of the model's extension, and what is claimed of it."""

    name: str
    value: float
    ci95: tuple[float, float] | None
    claim: str  # verdict and members of its group, in words


@dataclass(frozen=True, slots=True)
class RobotAnswer:
    """What a diagnosis found about a robot."""

    robot: RobotParameters  # as it was configured
    terms: tuple[FoundTerm, ...]
    valid: str = ""  # speeds, turn rates and logs that it was fitted to
    # standard deviation by channel, in its unit
    noise_sd: Mapping[str, float] = field(default_factory=dict)
    # of the radii in the controller that the robot has now; `robot` has equal wheels
    configured_difference: float = 0.0
    others: tuple[str, ...] = ()  # what was found beside the terms, in words

    @property
    def values(self) -> dict[str, float]:
        """Value of each term by name."""
        return {term.name: term.value for term in self.terms}

    @property
    def true(self) -> RobotParameters:
        """The robot with what was found."""
        return patched(self.robot, self.values)

    @property
    def configured(self) -> DriveGeometry:
        """What the controller that the robot has now takes for its geometry."""
        difference = {"wheel_radius_difference": self.configured_difference}
        return DriveGeometry.of(patched(self.robot, difference))

    def interval(self, name: str, quantity: Callable[[DriveGeometry], float]) -> str:
        """Return a number that follows from several terms, with its 95 % interval.

        Each term is moved to the ends of its interval alone; correlation is left out.
        """
        halves = [
            (
                self._at(quantity, term, term.ci95[1])
                - self._at(quantity, term, term.ci95[0])
            )
            / 2.0
            for term in self.terms
            if term.ci95 is not None and term.name in HELD
        ]
        value = quantity(DriveGeometry.of(self.true))
        if not halves:
            return f"{name} {value:.6g} (as configured, no interval)"
        return f"{name} {value:.6g} +- {hypot(*halves):.2g} (95 %)"

    def _at(
        self, quantity: Callable[[DriveGeometry], float], term: FoundTerm, value: float
    ) -> float:
        robot = patched(self.robot, {**self.values, term.name: value})
        return quantity(DriveGeometry.of(robot))


def files_for(answer: RobotAnswer, formats: tuple[str, ...]) -> dict[str, str]:
    """Return the text of each file by its path below a folder for them."""
    files = _tables(answer)
    for name in formats:
        written = FORMATS[name](answer)
        files |= {f"{name}/{file}": text for file, text in written.items()}
    return files


def _about(answer: RobotAnswer, purpose: str, *notes: str) -> list[str]:
    """Return the lines that stand above the numbers of every file."""
    lines = [
        "Made by 'hilserver diagnose'; take over the numbers, not the file.",
        purpose,
    ]
    for term in answer.terms:
        low_high = "no interval"
        if term.ci95 is not None:
            low_high = f"95 %: {term.ci95[0]:.6g} .. {term.ci95[1]:.6g}"
        row = TERMS[term.name]
        lines.append(
            f"{term.name} = {term.value:.6g} {row.unit} ({low_high}): {row.description};"
            f" {term.claim}"
        )
    lines += [
        f"Found, but in none of these numbers: {found}" for found in answer.others
    ]
    if not answer.terms:
        lines.append(
            "Nothing was found: the numbers are those of the configuration."
            if not answer.others
            else "The numbers are those of the configuration; see the report."
        )
    if answer.valid:
        lines.append(f"Valid for {answer.valid}")
    return [*lines, *notes]


def _not_held(answer: RobotAnswer, held: Collection[str] = HELD) -> list[str]:
    names = [term.name for term in answer.terms if term.name not in held]
    text = "Not, or only in part, in the numbers below, as this format has no place for it: "
    return [text + ", ".join(names)] if names else []


def _commented(lines: list[str], mark: str = "# ") -> str:
    # a log's name may contain anything, and a comment ends with its line
    return "".join(f"{mark}{' '.join(line.splitlines())}\n" for line in lines)


def _ros2_control(answer: RobotAnswer) -> dict[str, str]:
    robot = answer.robot
    true = DriveGeometry.of(answer.true)
    track_m = robot.track_m
    radius_m = robot.wheel_radius_m
    simulator, gap = for_simulator(answer.configured, true)
    if robot.is_mecanum:
        # its controller has one radius, for all wheels and both directions
        notes = _not_held(answer, HELD - {"wheel_radius_difference", "traction_slip"})
        gap = abs(true.left_m - true.right_m) / (true.left_m + true.right_m)
        real_text = mecanum_text(true)
        simulator_text = mecanum_text(simulator)
    else:
        notes = _not_held(answer)
        real_text = differential_text(true, radius_m, track_m)
        simulator_text = differential_text(simulator, radius_m, track_m)
    if "icr_offset" in answer.values:
        forward_m = answer.values["icr_offset"]
        notes.append(
            f"icr_offset: put base_link {forward_m:.6g} m further forward in the URDF"
        )
    notes += [*_limits(answer), *_differs(answer)]

    real = _about(
        answer,
        "For the real robot: with these its odometry is right. Not for a simulator.",
        *(
            answer.interval(name, quantity)
            for name, quantity in _quantities(robot).items()
        ),
        *notes,
        *_covariances(answer),
    )
    simulated = _about(
        answer,
        "For the simulator: with these the simulated robot, whose wheels roll as its"
        " controller assumes today, moves as the real one does with the parameters it has now.",
        f"What these numbers cannot copy: {gap:.2g} of the turn rate (unequal wheels)"
        if gap > 1e-9
        else "These numbers hold all of wheel radii and separation that was found.",
        *notes,
    )
    return {
        "real_robot.yaml": _commented(real) + real_text,
        "simulator.yaml": _commented(simulated) + simulator_text,
    }


def _quantities(
    robot: RobotParameters,
) -> dict[str, Callable[[DriveGeometry], float]]:
    """Return the parameters that give a controller the geometry, by name."""
    if robot.is_mecanum:
        return {
            "wheels_radius": lambda g: g.radius_m,
            PROJECTION.rpartition(".")[2]: lambda g: g.separation_m / 2.0,
        }
    track_m = robot.track_m
    radius_m = robot.wheel_radius_m
    return {
        "separation/wheel_separation": lambda g: g.separation_m / track_m,
        "left radius/wheel_radius": lambda g: g.left_m / radius_m,
        "right radius/wheel_radius": lambda g: g.right_m / radius_m,
    }


def _limits(answer: RobotAnswer) -> list[str]:
    """Return the limits of speed and acceleration, straight ahead and on the spot, as comments."""
    true = DriveGeometry.of(answer.true)
    rolled_m = true.radius_m * RAD_S_PER_RPM  # in a second, at 1 rpm
    turned_rad = 2.0 * rolled_m / true.separation_m
    most_rpm = answer.robot.max_rpm
    lines = [
        f"Wheels of {most_rpm:.6g} rpm at most (of the configuration) allow, straight ahead and on"
        f" the spot: linear.x.max_velocity: {most_rpm * rolled_m:.6g}, angular.z.max_velocity:"
        f" {most_rpm * turned_rad:.6g}"
    ]
    if "setpoint_rate_limit" in answer.values:
        rate_rpm_s = answer.values["setpoint_rate_limit"]
        lines.append(
            "setpoint_rate_limit, straight ahead and on the spot: linear.x.max_acceleration:"
            f" {rate_rpm_s * rolled_m:.6g}, angular.z.max_acceleration:"
            f" {rate_rpm_s * turned_rad:.6g}"
        )
    return lines


def _differs(answer: RobotAnswer) -> list[str]:
    """Return what to do with unequal radii of the user's file that the log did not show."""
    if not answer.configured_difference or "wheel_radius_difference" in answer.values:
        return []
    return [
        f"The radii in your file differ by {answer.configured_difference:.3%}, which the log did"
        " not show: if the report says that it could not, keep your two multipliers"
    ]


def _covariances(answer: RobotAnswer) -> list[str]:
    """Return a twist_covariance_diagonal of the noise of the wheels' speeds, as comments."""
    sds = [sd for name, sd in answer.noise_sd.items() if name.endswith(".speed_rpm")]
    if not sds:
        return ["The log does not show the noise of the wheels: no covariance"]
    true = DriveGeometry.of(answer.true)
    wheels = 2 if answer.robot.wheelbase_m is None else 4
    mean_variance = sum(sd * sd for sd in sds) / len(sds)
    variance = mean_variance / wheels
    along = (true.radius_m * RAD_S_PER_RPM) ** 2 * variance
    turn = 4.0 * along / true.separation_m**2
    unseen = "1000000.0, 1000000.0, 1000000.0"  # z, roll, pitch
    return [
        "Of the noise of the wheels' speeds alone, without slip:",
        f"twist_covariance_diagonal: [{along:.3g}, {along:.3g}, {unseen}, {turn:.3g}]",
        "pose_covariance_diagonal: the error of a pose grows with the way; no constant is right",
    ]


def _robot_localization(answer: RobotAnswer) -> dict[str, str]:
    offsets = {
        "gyro_bias": "subtract it from the gyro before the filter, which estimates no bias",
        "gyro_scale": "divide the gyro by 1 + a",
        "imu_latency": "subtract it from the stamp of the IMU",
        "nav_latency": "subtract it from the stamp of the position",
        "yaw_latency": "subtract it from the stamp of the yaw",
        "nav_lever_arm.x": "x of the antenna or tag in the URDF",
        "nav_lever_arm.y": "y of the antenna or tag in the URDF",
        "nav_frame_yaw": "yaw between the frames of map and odometry",
    }
    notes = [
        f"{n} = {v:.6g}: {offsets[n]}" for n, v in answer.values.items() if n in offsets
    ]
    notes += _not_held(answer, HELD | set(offsets))
    notes += _covariances(answer)
    for name in ("imu.gyro_z_rad_s", "nav.x_m", "nav.y_m", "nav.yaw_rad"):
        if name in answer.noise_sd:
            notes.append(
                f"variance of {name}, for its message: {answer.noise_sd[name] ** 2:.3g}"
            )
    notes.append(
        "process_noise_covariance: 'hilserver observe LOG --findings findings.json' prints the"
        " standard deviation s of the motion of a metre and of its heading; at v m/s, s^2 v belongs"
        " on the diagonal of x and y, and of yaw. Without it keep the default"
    )
    purpose = "For robot_localization, which takes covariances from the messages, not from here."
    return {
        "ekf.yaml": _commented(_about(answer, purpose, *notes))
        + """\
ekf_filter_node:
  ros__parameters:
    two_d_mode: true
    # x, y, z, roll, pitch, yaw, then their rates, then accelerations
    odom0: odom
    odom0_config: [false, false, false, false, false, false,
                   true, true, false, false, false, true,
                   false, false, false]
    imu0: imu
    imu0_config: [false, false, false, false, false, false,
                  false, false, false, false, false, true,
                  false, false, false]
"""
    }


def _of_simulated_body(answer: RobotAnswer, kind: str) -> str:
    notes = _not_held(answer)
    notes.append(
        "Inertia and friction of the floor are not measured: keep those that you have"
    )
    if "friction_anisotropy.ratio" in answer.values:
        ratio = answer.values["friction_anisotropy.ratio"]
        notes.append(
            f"friction_anisotropy: across the wheels {ratio:.4g} times the friction along them"
            " (mu2 over mu, with fdir1 along the wheel)"
        )
    if answer.robot.wheelbase_m is None:
        notes.append(
            "Two wheels stand as far apart as they turn the robot; if yours has four that"
            " scrub, keep your track: there it is the contact's friction (mu, mu2)"
        )
    else:
        turn = DriveGeometry.of(answer.true).separation_m / answer.robot.track_m
        notes.append(
            f"Four wheels scrub: they turn the robot as wheels {turn:.4g} times as far apart"
            " would; in a simulator that is the contact's friction (mu, mu2)"
        )
    purpose = f"For a simulator: wheels of the {kind} that move as the real ones do; leave its"
    purpose += (
        " controller as it is. Use this or ros2_control/simulator.yaml, never both."
    )
    text = _commented(_about(answer, purpose, *notes), "  ")
    return re.sub("-(?=-)", "- ", text)  # XML: no two hyphens within a comment


def _urdf(answer: RobotAnswer) -> dict[str, str]:
    comment = _of_simulated_body(answer, "URDF")
    geometry = DriveGeometry.of(answer.true)
    return {"wheels.urdf": urdf_text(answer.robot, geometry, comment)}


def _sdf(answer: RobotAnswer) -> dict[str, str]:
    comment = _of_simulated_body(answer, "SDF")
    geometry = DriveGeometry.of(answer.true)
    return {"wheels.sdf": sdf_text(answer.robot, geometry, comment)}


def _simulink(answer: RobotAnswer) -> dict[str, str]:
    purpose = "For MATLAB and Simulink: run it before the model. Terms as in the plant reference."
    lines = [
        f"robot.{name} = {value!r};  % {unit}" for name, value, unit in _numbers(answer)
    ]
    lines += [
        f"robot.terms.{term.name.replace('.', '_')} = {term.value!r};  % {TERMS[term.name].unit}"
        for term in answer.terms
    ]
    head = _commented(_about(answer, purpose), "% ")
    return {"robot_parameters.m": head + "\n".join([*lines, ""])}


def _numbers(answer: RobotAnswer) -> list[tuple[str, float, str]]:
    """Return name, value and unit of the robot's numbers with what was found."""
    robot = answer.true
    true = DriveGeometry.of(answer.true)
    values = answer.values
    controller = robot.controller
    process = robot.process
    k_p = controller.k_p * (1.0 + values.get("controller_gains.p", 0.0))
    k_i = controller.k_i * (1.0 + values.get("controller_gains.i", 0.0))
    gain = process.gain * (1.0 + values.get("process_gain", 0.0))
    t1_s = process.t1_s * (1.0 + values.get("time_constant", 0.0))
    return [
        ("wheel_radius_left", true.left_m, "m"),
        ("wheel_radius_right", true.right_m, "m"),
        ("wheel_separation", true.separation_m, "m"),
        (
            "k_p",
            k_p,
            "%/rpm",
        ),
        (
            "k_i",
            k_i,
            "%/(rpm s)",
        ),
        (
            "process_gain",
            gain,
            "rpm/%",
        ),
        ("t1", t1_s, "s"),
        ("t2", process.t2_s, "s"),
    ]


def _tables(answer: RobotAnswer) -> dict[str, str]:
    """Return the numbers and terms as CSV and JSON."""
    rows: list[dict[str, object]] = [
        {
            "name": name,
            "value": value,
            "unit": unit,
            "low": None,
            "high": None,
            "claim": "",
        }
        for name, value, unit in _numbers(answer)
    ]
    for term in answer.terms:
        low, high = term.ci95 or (None, None)
        rows.append(
            {
                "name": f"terms.{term.name}",
                "value": term.value,
                "unit": TERMS[term.name].unit,
                "low": low,
                "high": high,
                "claim": term.claim,
            }
        )
    table = io.StringIO()
    writer = csv.DictWriter(table, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    document = {"valid": answer.valid, "parameters": rows}
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    return {"parameters.csv": table.getvalue(), "parameters.json": text}


WRITTEN: Final = (
    "parameters.csv",
    "parameters.json",
    "ros2_control/real_robot.yaml",
    "ros2_control/simulator.yaml",
    "robot_localization/ekf.yaml",
    "urdf/wheels.urdf",
    "sdf/wheels.sdf",
    "simulink/robot_parameters.m",
)
"""Every file that may be written, so that those of an older diagnosis are known."""

FORMATS: Final[Mapping[str, Callable[[RobotAnswer], dict[str, str]]]] = {
    "ros2_control": _ros2_control,
    "robot_localization": _robot_localization,
    "urdf": _urdf,
    "sdf": _sdf,
    "simulink": _simulink,
}
"""What writes the files of each program, by the name that a user gives."""
