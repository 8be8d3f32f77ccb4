"""From a recipe to a log."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver_injector import machine as true_machine
from hilserver_injector.faults import apply
from hilserver_injector.manoeuvres import BENCHES, DRIVES, TABLES
from hilserver_injector.parameters import RECORD, machine
from hilserver_injector.recipe import WHEELS, Recipe
from hilserver_injector.sensors import as_read, tag, yaw_rate
from hilserver_injector.table import Table, Truth

Array = NDArray[np.float64]
HALL_START_M = 3.0


def make(recipe: Recipe) -> tuple[Table, Truth]:
    """Return the log of a recipe, and what is hidden in it."""
    steps = _row_steps(recipe)
    times = steps * true_machine.STEP_S
    course = _course(recipe, times)
    rows, dense = _drive(recipe, steps, course)
    values = _over_time(recipe, course)
    table = _record(recipe, times, rows, dense, values)
    notes: dict[str, Any] = {}
    apply(recipe, table, notes)
    return table, Truth(recipe, dense, notes)


def _row_steps(recipe: Recipe) -> NDArray[np.int64]:
    """Return the instants of the rows in steps of the machine, on the controller's ticks."""
    taken = recipe.taken
    rng = recipe.generator("rows")
    nominal = np.arange(0.0, recipe.length_s, 1.0 / taken.rate_hz)
    most = 0.2 / taken.rate_hz
    jitter = np.clip(
        taken.row_jitter_s * rng.standard_normal(len(nominal)), -most, most
    )
    ticks = np.round((nominal + jitter) * 1e3).astype(np.int64)
    ticks[0] = 0
    return ticks * round(1e-3 / true_machine.STEP_S)


def _course(recipe: Recipe, times: Array) -> Array:
    if recipe.drift_from is None:
        return np.ones(len(times))
    share = times / times[-1]
    return (share > 0.5).astype(float) if recipe.drift_step else share


def _drive(
    recipe: Recipe, steps: NDArray[np.int64], course: Array
) -> tuple[Array, Array]:
    rng = recipe.generator("manoeuvre")
    charge = float(recipe.generator("charge").uniform(0.45, 0.97))
    last = machine(recipe.causes, charge, recipe.drive)
    first = last
    if recipe.drift_from is not None:
        first = machine(recipe.drift_from, charge, recipe.drive)
    table, moves = np.zeros((0, 4)), np.zeros((1, 7))
    if recipe.kind == "bench":
        table = BENCHES[recipe.manoeuvre](rng, steps * true_machine.STEP_S)
    elif recipe.manoeuvre in TABLES:
        table = TABLES[recipe.manoeuvre](rng, steps * true_machine.STEP_S)
    else:
        moves = DRIVES[recipe.manoeuvre](rng, recipe.length_s)
    start = np.array(
        [*rng.uniform(-HALL_START_M, HALL_START_M, 2), rng.uniform(-np.pi, np.pi)]
    )
    rows = np.zeros((len(steps), true_machine.N_ROW))
    dense = np.zeros(
        (int(steps[-1]) // true_machine.DENSE_STEPS + 1, true_machine.N_DENSE)
    )
    constants = np.zeros(1, dtype=RECORD)
    lost, stalled = _interruptions(recipe, len(steps))
    true_machine.run(
        constants, constants.view(np.float64), first, last, course, steps,
        table, moves, lost, stalled, start, rows, dense,
    )  # fmt: skip
    if recipe.in_the_air:
        dense[:, 1:4] = start
        dense[:, 4:7] = 0.0
    return rows, dense


def _interruptions(
    recipe: Recipe, n: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which set-points do not arrive and when the controller stands still."""
    rng = recipe.generator("interruptions")
    lost, stalled = np.zeros((n, 4), dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    per_s = 1.0 / recipe.taken.rate_hz
    rate = recipe.causes.get("lost_setpoints.rate", 0.0)
    length = max(round(recipe.causes.get("lost_setpoints.length", 0.3) / per_s), 1)
    wheel = recipe.causes.get("lost_setpoints.wheel")
    which = slice(None) if wheel is None else int(wheel)
    for k in np.flatnonzero(rng.random(n) < rate * per_s):
        lost[k : k + length, which] = True
    for k in np.flatnonzero(
        rng.random(n) < recipe.causes.get("missed_ticks", 0.0) * per_s
    ):
        stalled[k : k + max(round(0.06 / per_s), 1)] = True
    every = recipe.causes.get("command_period")
    if every is not None:
        keep = np.zeros(n, dtype=np.bool_)
        keep[:: max(round(every / per_s), 1)] = True
        lost[~keep] = True
    return lost, stalled


def _over_time(recipe: Recipe, course: Array) -> dict[str, Array]:
    first: Mapping[str, float] = recipe.drift_from or recipe.causes
    return {
        name: first.get(name, value) + (value - first.get(name, value)) * course
        for name, value in recipe.causes.items()
    }


def _record(
    recipe: Recipe, times: Array, rows: Array, dense: Array, values: Mapping[str, Array]
) -> Table:
    taken, noise = recipe.taken, recipe.noise
    n, columns = len(times), {}
    rng = recipe.generator("wheels")
    if "setpoint" in taken.channels:
        for i, wheel in enumerate(WHEELS):
            columns[f"wheel.{wheel}.setpoint_rpm"] = rows[:, i].copy()
    if "speed" in taken.channels:
        for i, wheel in enumerate(WHEELS):
            added = noise.speed_rpm * rng.standard_normal(n)
            columns[f"wheel.{wheel}.speed_rpm"] = rows[:, 4 + i] + added
    if "duty" in taken.channels:
        for i, wheel in enumerate(WHEELS):
            added = noise.duty_pct * rng.standard_normal(n)
            columns[f"wheel.{wheel}.duty_pct"] = rows[:, 8 + i] + added
    if "gyro" in taken.channels:
        columns["imu.gyro_z_rad_s"] = yaw_rate(recipe, values, dense, times)
    if "nav" in taken.channels or "nav_position" in taken.channels:
        due = np.floor(times * taken.nav_hz + 1e-9)
        at = np.flatnonzero(np.diff(due, prepend=-1.0) > 0.0)
        local = {name: value[at] for name, value in values.items()}
        sampled = tag(recipe, local, dense, times[at])
        names = ["nav.x_m", "nav.y_m"] + ["nav.yaw_rad"] * ("nav" in taken.channels)
        for name, series in zip(names, sampled, strict=False):
            columns[name] = np.full(n, np.nan)
            columns[name][at] = series
    if "battery" in taken.channels:
        added = noise.voltage_v * recipe.generator("battery").standard_normal(n)
        columns["battery.voltage_v"] = rows[:, 12] + added
    return _with_gaps(recipe, Table(times.copy(), as_read(recipe, columns)))


def _with_gaps(recipe: Recipe, table: Table) -> Table:
    """Take samples and rows out, and shift stamps, as the recorder did."""
    taken, rng = recipe.taken, recipe.generator("gaps")
    for name, values in table.columns.items():
        if not name.endswith("setpoint_rpm"):
            values[rng.random(len(values)) < taken.missing] = np.nan
    if taken.stamp_jitter_s > 0.0:
        table.t_s = table.t_s + taken.stamp_jitter_s * rng.standard_normal(
            len(table.t_s)
        )
        table.t_s = np.maximum.accumulate(table.t_s + 1e-9 * np.arange(len(table.t_s)))
    keep = rng.random(len(table.t_s)) >= taken.missing_rows
    table.t_s = table.t_s[keep]
    table.columns = {name: values[keep] for name, values in table.columns.items()}
    return table
