"""Windows that another program has made: the injector's robot, with what is hidden in it."""

from dataclasses import replace

import numpy as np
from hilserver_injector.make import make
from hilserver_injector.recipe import Recipe

from hilserver.config.root import Config, without_passwords
from hilserver.recalibration.orders import JudgeOrder, Todo

LENGTH_S = 120.0
# noise of what stands
AT_REST = {"speed": 0.12, "duty": 0.15, "nav.": 0.02, "gyro": 0.006}


def write(path, causes, seed, *, drift_from=None, faults=None, length_s=LENGTH_S):
    """Write one window of driving; return its path."""
    recipe = Recipe(
        seed=seed, causes=causes, duration_s=length_s, drift_from=drift_from
    )
    recipe = replace(recipe, drift_step=drift_from is not None, faults=faults or {})
    make(recipe)[0].write_csv(path)
    return path


def stopped(path, causes, seed, after_s):
    """Write one window of a robot that then stands: its sensors' noise about where it is."""
    recipe = Recipe(seed=seed, causes=causes, duration_s=LENGTH_S)
    table, rng = make(recipe)[0], np.random.default_rng(seed)
    stands = table.t_s >= after_s
    for name, values in table.columns.items():
        there = np.flatnonzero(stands & np.isfinite(values))
        place = values[there[0]] if name.startswith("nav.") and len(there) else 0.0
        sd = next((sd for word, sd in AT_REST.items() if word in name), 0.0)
        values[there] = place + sd * rng.standard_normal(len(there))
    table.write_csv(path)
    return path


def record(
    path, causes, seed, *, stamped=True, late_ticks=10, lost=0.0, length_s=LENGTH_S
):
    """Write one window as a daemon records it, of a robot that drives as the twin's.

    The robot follows each set-point up to `late_ticks` later than the daemon latches it, and what
    it reports comes in up to as late, but for a share that is `lost`; unless `stamped` nobody knows
    when it was.
    """
    recipe = Recipe(seed=seed, causes=causes, duration_s=length_s, manoeuvre="ramps")
    table, rng = make(recipe)[0], np.random.default_rng(seed)
    own = np.rint(1e3 * table.t_s).astype(int) + late_ticks
    came, sent = (
        own + sign * rng.integers(0, late_ticks + 1, len(own)) for sign in (1, -1)
    )
    held, kept = {}, rng.random(len(own)) >= lost
    for name, values in table.columns.items():
        there = np.isfinite(values) & kept
        at, sampled, group = came[there], values[there], name.split(".")[0]
        held[f"measured.{name}"] = at, sampled
        if name.endswith("setpoint_rpm"):
            held[name] = sent, values
            if not stamped:
                del held[f"measured.{name}"]
        if stamped and group in ("wheel", "imu", "nav"):
            news = there if group == "nav" else kept
            held[f"internal.samples_{group}"] = (
                came[news],
                np.arange(1.0, sum(news) + 1),
            )
            held[f"internal.taken_{group}_s"] = came[news], 1e-3 * (own[news] + 0.37)
    ticks = np.unique(np.concatenate([at for at, _ in held.values()]))
    rows = [1e-3 * ticks, ticks.astype(float)]
    rows += [
        np.append(0.0, v)[np.searchsorted(at, ticks, side="right")]
        for at, v in held.values()
    ]
    header = ",".join(["t_s", "sim.tick", *held])
    np.savetxt(path, np.transpose(rows), "%.12g", ",", header=header, comments="")
    return path


def order(path, todo=None, **fields):
    """Return the order to look at a window with the default configuration."""
    what = {"folder": str(path.parent), "parameters": {}, "report": ""} | fields
    todo = Todo(1, {}, look=True) if todo is None else todo
    return JudgeOrder(todo, str(path), without_passwords(Config()), **what)
