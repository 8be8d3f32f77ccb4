"""From a diagnosis to the files of other programs (`hilserver diagnose --for`)."""

from dataclasses import replace
from math import hypot
from pathlib import Path

import yaml

from hilserver.config.patch import FittedIn
from hilserver.diagnosis.findings.patch import MAX_NAMES
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.diagnosis.schema.findings import Finding, Findings, Verdict
from hilserver.exchange import (
    WRITTEN,
    DescribedRobot,
    FoundTerm,
    RobotAnswer,
    files_for,
)
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.terms import main_part


def user_files(
    diagnosis: Diagnosis,
    robot: RobotParameters,
    formats: tuple[str, ...],
    configured_difference: float = 0.0,
) -> dict[str, str]:
    """Return the text of each file by its path; those of groups stand in folders of their own.

    Parameters
    ----------
    configured_difference : float
        Of the wheels' radii in the controller that the robot has now.
    """
    files: dict[str, str] = {}
    for group in diagnosis.findings.groups or ("",):
        folder = f"for/{group}" if group else "for"
        answer = _answer(diagnosis, robot, group)
        answer = replace(answer, configured_difference=configured_difference)
        written = files_for(answer, formats)
        files |= {f"{folder}/{name}": text for name, text in written.items()}
    return files


def older_files(folder: Path) -> list[str]:
    """Return what a diagnosis wrote for other programs into a folder, alone or for groups."""
    below = folder / "for"
    groups = [below, *(group for group in below.glob("*") if group.is_dir())]
    names = ("config.yaml", *WRITTEN)
    found = (group / name for group in groups for name in names)
    return [str(file.relative_to(folder)) for file in found if file.is_file()]


def configuration(described: DescribedRobot) -> dict[str, str]:
    """Return the configuration of the robot that a file describes, for runs with the patch."""
    keys = {
        "plant": described.plant,
        "kinematics": {"rotation_gain": described.rotation_gain},
    }
    head = "# The robot as its file describes it: hilserver run -c config.yaml --patch ...\n"
    return {"for/config.yaml": head + yaml.safe_dump(keys, sort_keys=False)}


def _answer(diagnosis: Diagnosis, robot: RobotParameters, group: str) -> RobotAnswer:
    findings, terms = diagnosis.findings, []
    for item in diagnosis.evidence.extension:
        own = (item.parameter.groups or {}).get(group, item.parameter)
        name = main_part(item.name)
        terms.append(FoundTerm(name, own.value, own.ci95, _claim(findings, item.name)))
    noise = findings.noise
    if group and findings.groups:
        noise = findings.groups[group].noise
    noise_sd = {name: hypot(n.white_sd, n.ou_sd) for name, n in noise.items()}
    others = [
        _said(finding)
        for finding in findings.findings
        if finding.verdict != Verdict.DATA_FAULT
        and not any(_is_of(i.name, finding) for i in diagnosis.evidence.extension)
    ]
    return RobotAnswer(
        robot, tuple(terms), _valid(diagnosis), noise_sd, others=tuple(others)
    )


def _claim(findings: Findings, term: str) -> str:
    """Return verdict and members of the finding that a term belongs to."""
    for finding in findings.findings:
        if _is_of(term, finding):
            return _said(finding)
    return "fitted"


def _is_of(term: str, finding: Finding) -> bool:
    return term in finding.parameters or term.partition(".")[0] in finding.causes


def _said(finding: Finding) -> str:
    if not finding.causes:
        return str(finding.verdict)
    text = f"{finding.verdict}: {' or '.join(finding.causes)}"
    if len(finding.causes) > 1:
        text += (
            ", which the log cannot separate; the numbers are right if it is the first"
        )
    return text


def _valid(diagnosis: Diagnosis) -> str:
    fitted: FittedIn = diagnosis.evidence.fitted
    ranges = (
        ("m/s", fitted.speed_m_s),
        ("rad/s", fitted.turn_rate_rad_s),
        ("rpm of the wheels", fitted.wheel_speed_rpm),
        ("V", fitted.voltage_v),
    )
    parts = [f"{r[0]:.3g} .. {r[1]:.3g} {unit}" for unit, r in ranges if r is not None]
    names = [log.file for log in diagnosis.findings.logs[:MAX_NAMES]]
    more = len(diagnosis.findings.logs) - len(names)
    logs = ", ".join(names) + (f" and {more} more" if more else "")
    return "; ".join([*parts, f"fitted to {logs}"])
