"""The thesis's figures, from both models and what was measured."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.report.svg import (
    MARGIN_BOTTOM,
    MARGIN_LEFT,
    MARGIN_RIGHT,
    MARGIN_TOP,
    Figure,
    Plot,
    picture,
    span_of,
)
from hilserver.experiment.gaps import (
    COLUMNS,
    KINEMATIC,
    MECHATRONIC,
    NAMES,
    UNITS,
    BesideModels,
    Measured,
)
from hilserver.experiment.thesis import Experiment
from hilserver.measured.channels import SETPOINTS, SPEEDS
from hilserver.plant.layout import WHEEL_WORDS, WHEELS

ROLES: Final = {KINEMATIC: "simulated", MECHATRONIC: "extended"}
TITLES: Final = {
    "x": "x over time",
    "y": "y over time",
    "yaw": "Yaw over time",
    "turn": "Turn rate over time",
}
GAP_ROLES: Final = {KINEMATIC: "before", MECHATRONIC: "after"}
WIDTH, HEIGHT, REST, PATH_HEIGHT = 520.0, 230.0, 180.0, 400.0


def numbered(title: str, number: str | None) -> str:
    """Return a title with the number of the thesis's figure, if it has one."""
    if number is None:
        return title
    return (
        f"{title} ({'figures' if ' ' in number else 'figure'} {number} of the thesis)"
    )


def wheels(
    both: BesideModels, experiment: Experiment
) -> tuple[list[Figure], list[tuple[str, str]]]:
    """Draw the speeds of all wheels; return the legend, too."""
    if "left" in experiment.figures:
        # the thesis compares front and rear: the captions say what is what
        return [of_side(both, experiment, side) for side in ("left", "right")], []
    legend = [("setpoint", "set-point"), ("measured", "speed in the recording")]
    if not both.courses.are_measured:
        legend[1] = ("simulated", "speed of the simulated drive")
    return [of_wheel(both, w) for w in range(len(WHEELS))], legend


def of_wheel(both: BesideModels, w: int) -> Figure:
    """Draw the speed of one wheel, and its set-point."""
    courses = both.courses
    name = WHEEL_WORDS[WHEELS[w]]
    plot = plot_of_wheels(both, [w], SETPOINTS[w], SPEEDS[w])
    if SETPOINTS[w] in courses.log:
        # a set-point holds until the next one
        t_s, asked, span = courses.of(SETPOINTS[w])
        stairs_s = np.repeat(t_s, 2)[1:]
        held = np.repeat(asked, 2)[:-1]
        run = np.repeat(span, 2)[:-1]
        plot.line(stairs_s, held, "setpoint", f"{name}: set-point", run=run)
    if SPEEDS[w] in courses.log:
        t_s, speed, span = courses.of(SPEEDS[w])
        plot.line(t_s, speed, "measured", f"{name}: measured speed", run=span)
    if not courses.are_measured:
        speed = courses.wheels_rpm[:, w]
        plot.line(
            courses.t_s,
            speed,
            "simulated",
            f"{name}: simulated drive",
            run=courses.span,
        )
    title = f"{name} wheel".capitalize()
    return Figure(picture([plot], title), title, "")


def of_side(both: BesideModels, experiment: Experiment, side: str) -> Figure:
    """Draw front and rear wheel of a side over each other."""
    courses = both.courses
    front, rear = (w for w, name in enumerate(WHEELS) if name.endswith(side[0]))
    plot = plot_of_wheels(both, [front, rear])
    for w, role in ((front, "measured"), (rear, "simulated")):
        speed = courses.wheels_rpm[:, w]
        title = WHEEL_WORDS[WHEELS[w]]
        plot.line(courses.t_s, speed, role, title, run=courses.span)
    title = numbered(f"{side} wheels".capitalize(), experiment.figures[side])
    caption = "Black: front wheel. Orange, dashed: rear wheel."
    return Figure(picture([plot], title), title, caption)


def plot_of_wheels(both: BesideModels, which: Sequence[int], *signals: str) -> Plot:
    """Return axes on which the speeds of some wheels, and some signals of the log, have room."""
    courses = both.courses
    shown = [courses.wheels_rpm[:, which].ravel()]
    shown += [courses.log[name].values for name in signals if name in courses.log]
    time_s = span_of(courses.t_s, margin=0.0)
    return Plot(time_s, span_of(*shown), "time [s]", "speed [rpm]", height=HEIGHT)


def over_time(both: BesideModels, experiment: Experiment, channel: str) -> Figure:
    """Draw one channel of both models and of the robot, and below it the gaps of the models."""
    courses = both.courses
    shown = both.measured.get(channel)
    name = NAMES[channel]
    column = COLUMNS.index(channel)
    title = numbered(TITLES[channel], experiment.figures.get(channel))
    curves = {model: values[:, column] for model, values in both.models.items()}
    values = list(curves.values())
    if shown is not None:
        values.append(shown.values)

    time_s = span_of(courses.t_s, margin=0.0)
    label = f"{name} [{UNITS[channel]}]"
    plot = Plot(time_s, span_of(*values), "time [s]", label, height=HEIGHT)
    plots = [plot]
    caption = ""
    if shown is not None:
        plot.x_label = ""
        plot.line(
            shown.t_s, shown.values, "measured", f"{name} measured", run=shown.span
        )
        plots.append(gaps_over_time(both, shown, curves, UNITS[channel]))
        caption = "Above: values. Below: model minus black curve."
    for model, curve in curves.items():
        plot.line(
            courses.t_s, curve, ROLES[model], f"{name}, {model}", run=courses.span
        )
    return Figure(picture(plots, title), title, caption)


def gaps_over_time(
    both: BesideModels, shown: Measured, curves: Mapping[str, Array], unit: str
) -> Plot:
    """Draw how far the models are from what was measured."""
    gaps = {
        model: both.at(shown, curve) - shown.values for model, curve in curves.items()
    }
    time_s = span_of(both.courses.t_s, margin=0.0)
    ranges = span_of(*gaps.values(), np.zeros(1))
    plot = Plot(
        time_s, ranges, "time [s]", f"gap [{unit}]", height=REST, top=HEIGHT - 24
    )
    plot.level(0.0)
    for model, apart in gaps.items():
        role = GAP_ROLES[model]
        title = f"{model} minus measured"
        plot.line(shown.t_s, apart, role, title, run=shown.span)
    return plot


def path(both: BesideModels, experiment: Experiment) -> Figure:
    """Draw the path in the plane, to scale."""
    tracks = {ROLES[name]: model[:, :2] for name, model in both.models.items()}
    begins = dict.fromkeys(tracks, both.courses.span)
    if both.place is not None:
        tracks = {"measured": both.place} | tracks
        begins["measured"] = both.measured["x"].span

    x, y = to_scale(np.concatenate(list(tracks.values())))
    plot = Plot(x, y, "x [m]", "y [m]", height=PATH_HEIGHT)
    for role, xy in tracks.items():
        cuts = np.flatnonzero(np.diff(begins[role])) + 1
        plot.track(xy, role, role, begins=cuts.tolist())
    start = next(iter(tracks.values()))[:1]
    plot.dots(start[:, 0], start[:, 1], "start", ["start"])
    title = numbered("Path in the plane", experiment.figures.get("path"))
    return Figure(picture([plot], title), title, "To scale. Ring: where it begins.")


def to_scale(xy: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return ranges of x and y that hold all points, and in which a metre is a metre."""
    left, right = span_of(xy[:, 0])
    low, high = span_of(xy[:, 1])
    width = WIDTH - MARGIN_LEFT - MARGIN_RIGHT
    height = PATH_HEIGHT - MARGIN_TOP - MARGIN_BOTTOM
    a_pixel_m = max((right - left) / width, (high - low) / height)
    x = 0.5 * (left + right)
    y = 0.5 * (low + high)
    half_x = 0.5 * a_pixel_m * width
    half_y = 0.5 * a_pixel_m * height
    x_span = (x - half_x, x + half_x)
    y_span = (y - half_y, y + half_y)
    return x_span, y_span
