"""The page of the robots: what each robot of the documents can do by each how-to, or why not.

``python -m reference.robots`` runs all of it, which takes minutes, and writes the page; a long test
compares.
"""

import contextlib
import io
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple

from hilserver.commands import main

PAGE: Final = Path(__file__).parents[1] / "docs" / "reference" / "robots.md"

ROBOTS: Final[Mapping[str, str]] = {
    "IOT Bot": "",
    "mecanum": "drive: mecanum",
    "TurtleBot3": "wheel_radius_m: 0.033, wheelbase_m: null, track_m: 0.16, icr_offset_m: 0,"
    " max_rpm: 65",
    "Husky": "wheel_radius_m: 0.165, track_m: 0.55, wheelbase_m: 0.512, icr_offset_m: 0,"
    " max_rpm: 58",
}
"""Robots by name, each with its section ``plant``."""

_SCENARIO: Final = """
steps:
  - {at_s: 0.1, write: {control.mode: 1, twist.linear_m_s: 0.1, twist.angular_rad_s: 0.2}}
  - {at_s: 3.0, write: {twist.linear_m_s: 0.0, twist.angular_rad_s: -0.2}}
"""
_SWEEP: Final = """
machines: 4
config: config.yaml
from: {population: {process.gain: {sd: 0.03}}}
drive: {scenario: drive.yaml, duration_s: 4}
require: [{name: goes ahead, signal: pose.x_m, above: 0.1, within_s: 4}]
"""


class HowTo(NamedTuple):
    """What a how-to does: a command, with sections of the configuration beside the robot's."""

    page: str  # with the words of its link
    words: str
    sections: str = ""


def _started(sections: str) -> str:
    """Return sections of a daemon that disturbs no other one on this computer."""
    return (
        f"{sections}\nopcua: {{enabled: false}}\nmetrics: {{enabled: false}}\n"
        "image: {name: auto}\nscheduler: {backend: virtual}"
    )


def _node(flavour: str) -> str:
    asked = "publish: [robot_description, /tf]"
    return _started(f"ros2: {{enabled: true, domain: 87, flavour: {flavour}, {asked}}}")


HOW_TOS: Final = (
    HowTo("[describe it](../how-to/own-robot.md)", "check"),
    HowTo("[simulate](../how-to/simulate.md)", "simulate drive.yaml -o drive.mcap"),
    HowTo(
        "[replay](../how-to/record-and-replay.md)",
        "replay drive.mcap -o again.csv --check",
    ),
    HowTo("[a bag of it](../how-to/record-and-replay.md)", "convert drive.mcap bag"),
    HowTo("[diagnose](../how-to/diagnose.md)", "diagnose drive.mcap -o found"),
    HowTo(
        "[estimate where it was](../how-to/observe.md)",
        "observe drive.mcap -o where.csv",
    ),
    HowTo("[sweep](../how-to/sweep.md)", "sweep sweep.yaml -o sweep"),
    HowTo(
        "[URDF](../how-to/mechatronic.md#take-the-robot-elsewhere)",
        "model --format urdf",
    ),
    HowTo(
        "[MJCF](../how-to/mechatronic.md#take-the-robot-elsewhere)",
        "model --format mjcf",
    ),
    HowTo(
        "[the mechatronic model](../how-to/mechatronic.md)",
        "simulate drive.yaml -o body.mcap",
        "mechatronic: {enabled: true}",
    ),
    HowTo(
        "[the robot's own driver](../how-to/shield.md)",
        "run --duration 0.5",
        _started("shield: {enabled: true, link: shield}"),
    ),
    HowTo("[as an FMU](../how-to/export-fmu.md)", "fmu --platforms none -o robot.fmu"),
    *(
        HowTo(
            f"[ROS 2](../how-to/ros2.md#flavours): `{flavour}`",
            "run --duration 0.5",
            _node(flavour),
        )
        for flavour in ("iotbot_shield", "eduard", "thesis_sil", "diff_drive")
    ),
)
_PLACE: Final = re.compile(r"^(hilserver: )?(config\.yaml:\d+: )?")
_NO_CONFIG: Final = ("convert", "replay", "sweep")
"""Commands whose files say which robot it is."""


def outcome(folder: Path, robot: str, how_to: HowTo) -> str:
    """Return "yes", or the sentence by which a command refuses a robot."""
    config, said = folder / "config.yaml", io.StringIO()
    config.write_text(f"plant: {{{ROBOTS[robot]}}}\n{how_to.sections}\n")
    words = how_to.words.split()
    if words[0] not in _NO_CONFIG:
        words += ["-c", "config.yaml"]
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(said),
    ):
        code = main(words)
    lines = said.getvalue().strip().splitlines() or [f"exit code {code}"]
    return "yes" if code == 0 else _PLACE.sub("", lines[-1])


def outcomes(robot: str) -> Iterator[str]:
    """Yield what a robot can do, or why not, by how-to; each goes on with the files of the last."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "drive.yaml").write_text(_SCENARIO)
        (folder / "sweep.yaml").write_text(_SWEEP)
        for how_to in HOW_TOS:
            yield outcome(folder, robot, how_to)


def as_markdown(columns: Mapping[str, list[str]]) -> str:
    """Return the page; `columns` has the outcomes of each robot."""
    reasons: dict[str, int] = {}

    def cell(said: str) -> str:
        if said == "yes":
            return said
        return f"no ({reasons.setdefault(said, len(reasons) + 1)})"

    rows = []
    for how_to, row in zip(HOW_TOS, zip(*columns.values(), strict=True), strict=True):
        rows.append(f"| {how_to.page} | {' | '.join(map(cell, row))} |")
    robots = "\n".join(f"| {name} | `plant: {{{ROBOTS[name]}}}` |" for name in columns)
    table = "\n".join(rows)
    notes = "\n".join(f"{number}. {why}" for why, number in reasons.items())
    return f"""# Robots and how-tos

What the robots of these documents can do, and why not. `python -m reference.robots` has tried each
cell with the command of its how-to.

| | {" | ".join(columns)} |
|---|{"---|" * len(columns)}
{table}

{notes}

| robot | configuration |
|---|---|
{robots}
"""


if __name__ == "__main__":
    found = {robot: list(outcomes(robot)) for robot in ROBOTS}
    PAGE.write_text(as_markdown(found), encoding="utf-8")
