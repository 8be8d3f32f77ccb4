"""The page: what was driven, the thesis's figures with three curves, gaps, identification."""

from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from jinja2 import ChoiceLoader, Environment, PackageLoader

from hilserver import __version__
from hilserver.diagnosis.findings.explain import number
from hilserver.diagnosis.report.page import environment
from hilserver.experiment.gaps import (
    KINEMATIC,
    MEASURED,
    MECHATRONIC,
    NAMES,
    BesideModels,
    Gap,
)
from hilserver.experiment.identification import Identified
from hilserver.experiment.report import figures
from hilserver.experiment.thesis import Experiment

REPORT: Final = "report.html"


class Third(NamedTuple):
    """The robot whose curves stand beside the models."""

    label: str  # for legends
    text: str  # what it is, and what its gap to the models can show


def third_of(measured: Path | None, *, has_body: bool) -> Third:
    """Return what stands beside the models: a recording, or the robot that drove instead."""
    if measured is not None:
        return Third(
            "measured",
            f"Black: what {measured.name} measured. The models start with it.",
        )
    not_real = "Nothing was measured here. Black is the true pose of a simulated robot,"
    yours = "To see how well they fit the real robot, give a recording of it with --measured."
    if has_body:
        label = "simulated robot: body driven by torque"
        text = (
            "a body whose wheels its drives turn with their torque. The mechatronic model is the"
            " same body, driven by the speeds of these wheels: the gaps show what that leaves out,"
            " and what the kinematic model leaves out of a body."
        )
    else:
        label = "simulated robot: planar plant"
        text = "the planar plant, which is the kinematic model with a drive: there is no gap to it."
    return Third(label, f"{not_real} {text} {yours}")


def render(
    experiment: Experiment,
    both: BesideModels,
    third: Third,
    identified: Identified,
    origin: list[tuple[str, str]],
) -> str:
    """Return the report as one HTML file without any reference to the network.

    Parameters
    ----------
    origin : list of (str, str)
        What it rests on: names and values.
    """
    courses = both.courses
    gaps = both.gaps()
    curves = [figures.over_time(both, experiment, channel) for channel in both.channels]
    if "x" in both.channels:
        curves.insert(2, figures.path(both, experiment))
    legend = [("measured", third.label), ("simulated", KINEMATIC)]
    if courses.mechatronic is not None:
        legend.append(("extended", f"{MECHATRONIC}, driven by the wheel speeds"))

    wheels, of_wheels = figures.wheels(both, experiment)
    notes = list(courses.notes)
    if courses.missing:
        notes.append(courses.missing)
    title = figures.numbered("Wheel speeds", experiment.figures.get("wheels"))
    return (
        report_environment()
        .get_template("experiment.html.j2")
        .render(
            experiment=experiment,
            headline=f"Experiment {experiment.name}: {experiment.title}",
            best=sentence(gaps),
            third=third,
            curves=curves,
            legend=legend,
            gaps=gaps,
            names=NAMES,
            identified=identified,
            wheels_title=title,
            wheels_legend=of_wheels,
            wheels=wheels,
            reading=reading(both),
            notes=notes,
            origin=origin,
            version=__version__,
        )
    )


def reading(both: BesideModels) -> str:
    """Say what the wheel speeds of the recording were taken for."""
    if both.courses.are_measured:
        return "Both models run on the wheel speeds of the recording, taken as actual speeds."
    return (
        "The wheel speeds of the recording are set-points, or were judged to be: both models run on"
        " the speeds that the simulated drive, (5.23) with its controller, makes of them."
    )


def sentence(gaps: list[Gap]) -> str:
    """Say how far the models are from the robot, or from each other."""
    own = [g for g in gaps if g.beside == MEASURED] or gaps
    shown = [g for g in own if g.channel == own[0].channel]
    if not shown:
        return "Nothing was measured that a model could be compared with."
    parts = [f"{g.of} {number(g.rms, g.unit, digits=2)}" for g in shown]
    return f"Gap in {NAMES[shown[0].channel]}, root mean square: {', '.join(parts)}."


@cache
def report_environment() -> Environment:
    """Return the template environment: that of the diagnosis, with this room's template."""
    loaders = [PackageLoader("hilserver.experiment.report"),
               PackageLoader("hilserver.diagnosis.report")]  # fmt: skip
    return environment().overlay(loader=ChoiceLoader(loaders))
