"""Windows that another program has made: the injector's robot, with what is hidden in it."""

from dataclasses import replace

from hilserver_injector.make import make
from hilserver_injector.recipe import Recipe

from hilserver.config.root import Config, without_passwords
from hilserver.recalibration.orders import Order, Todo

LENGTH_S = 120.0


def write(path, causes, seed, *, drift_from=None, faults=None, length_s=LENGTH_S):
    """Write one window of driving; return its path."""
    recipe = Recipe(seed=seed, causes=causes, duration_s=length_s, drift_from=drift_from)
    recipe = replace(recipe, drift_step=drift_from is not None, faults=faults or {})
    make(recipe)[0].write_csv(path)
    return path


def order(path, todo=None, **fields):
    """Return the order to look at a window with the default configuration."""
    what = {"folder": str(path.parent), "parameters": {}, "report": ""} | fields
    todo = Todo(1, {}, look=True) if todo is None else todo
    return Order(todo, str(path), without_passwords(Config()), **what)
