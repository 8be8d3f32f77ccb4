"""A sweep in words, for the terminal and the head of the report; two sweeps compared."""

import numpy as np

from hilserver.errors import LogError
from hilserver.sweep.draws import Draws
from hilserver.sweep.estimates import (
    LEAST_MACHINES,
    exact_interval,
    median_interval,
    paired_p,
)
from hilserver.sweep.model import Distribution
from hilserver.sweep.prepare import PreparedSweep
from hilserver.sweep.rig import MachineOutcome
from hilserver.sweep.table import ERROR, PASSED, REFUSED, MachineTable

MOST_TRIED = 1000  # machines drawn to estimate how many cannot be built


def headline(table: MachineTable) -> str:
    """Return a sentence on the share that passes."""
    n = len(table) - table.count(REFUSED)
    if n == 0:
        return (
            "No machine could be built: every draw has a parameter outside its range."
        )
    passed = table.count(PASSED)
    return f"{passed} of {n} machines pass: {100 * passed / n:.1f} %"


def details(table: MachineTable) -> str:
    """Return how certain the share is, and what became of the other machines."""
    n = len(table) - table.count(REFUSED)
    low, high = exact_interval(table.count(PASSED), n)
    text = f"95 % between {100 * low:.1f} % and {100 * high:.1f} %."
    if failed := table.count(ERROR):
        text += f" The controller failed on {failed}."
    if refused := table.count(REFUSED):
        text += f" {refused} more draws were left out because a parameter is outside its range."
    return text


def scope(table: MachineTable) -> str:
    """Return whether the share concerns one machine or many."""
    one = table.about["of_one_machine"]
    many = table.about["population"]
    if one and many:
        return (
            "The machines are one machine with the uncertainty left by its diagnosis, and also"
            " vary in"
            f" {', '.join(many)}: the share mixes both."
        )
    if one:
        return (
            "The machines are all the same machine, with the uncertainty left by its diagnosis:"
            " the share is the probability that the controller passes on that machine."
        )
    return (
        "The machines are a population: the share is the proportion of its machines on which the"
        " controller passes. It says nothing about machines outside this population."
    )


def plan(
    prepared: PreparedSweep, outcome: MachineOutcome, seconds: float, workers: int
) -> str:
    """Return what a sweep would do, and how long it would take."""
    sweep = prepared.sweep
    draws = prepared.draws
    tried = min(sweep.machines, MOST_TRIED)
    machines = map(prepared.machine, range(tried))
    refused = [m.refused for m in machines if m.p is None]
    duration_s = prepared.job.n_ticks * prepared.assembly.base_period_ns * 1e-9
    lines = [
        f"{sweep.machines} machines, {duration_s:g} s each, {len(sweep.require)} requirements"
    ]
    lines += [f"  {name}: {_drawn(name, draws)}" for name in draws.names]
    lines += [
        f"  left out, not a parameter of a robot: {name}" for name in prepared.left_out
    ]
    lines.append(
        f"{len(refused)} of the first {tried} draws have a parameter outside its range"
    )
    lines += [f"  for example: {refused[0]}"] if refused else []
    said = (
        outcome.error or outcome.refused or f"smallest margin {min(outcome.margins):g}"
    )
    lines.append(f"machine 0 took {seconds:.2f} s: {said}")
    total_s = seconds * sweep.machines / workers
    lines.append(f"total: about {total_s / 60:.1f} min with {workers} workers")
    return "\n".join(lines)


def _drawn(name: str, draws: Draws) -> str:
    if name not in draws.population:
        return "from the findings, with its covariance"
    distribution: Distribution = draws.population[name]
    if distribution.uniform is not None:
        return "uniform {:g} .. {:g}".format(*distribution.uniform)
    if distribution.values is not None:
        return f"one of {', '.join(f'{value:g}' for value in distribution.values)}"
    mean = draws.nominal[name] if distribution.mean is None else distribution.mean
    return f"normal, mean {mean:g}, sd {distribution.sd:g}"


def compare(a: MachineTable, b: MachineTable) -> str:
    """Return what differs between two sweeps of the same machines, as text.

    LogError if the machines differ.
    """
    mine, other = _shared(a, b)
    in_a = [a.status[row] == PASSED for row in mine]
    passed_a = np.array(in_a, dtype=bool)
    in_b = [b.status[row] == PASSED for row in other]
    passed_b = np.array(in_b, dtype=bool)
    only_a = int((passed_a & ~passed_b).sum())
    only_b = int((~passed_a & passed_b).sum())
    both = int((passed_a & passed_b).sum())
    neither = len(mine) - both - only_a - only_b
    lines = [
        f"{len(mine)} machines, the same in both",
        f"pass in both {both}, only in A {only_a}, only in B {only_b},"
        f" in neither {neither}",
        f"probability of such a difference by chance: {paired_p(only_a, only_b):.3g} (McNemar,"
        " exact)",
    ]
    for name in a.margins:
        if name not in b.margins:
            continue
        change = b.margins[name][other] - a.margins[name][mine]
        change = change[np.isfinite(change)]
        if len(change) < LEAST_MACHINES:
            continue
        median, low, high = median_interval(change)
        lines.append(
            f"{name}: margin in B minus A, median {median:.4g} ({low:.4g} .. {high:.4g}),"
            f" larger on {(change > 0).mean():.1%} of the machines"
        )
    return "\n".join(lines)


def _shared(a: MachineTable, b: MachineTable) -> tuple[list[int], list[int]]:
    """Return the rows of the machines that are in both."""
    rows = {int(index): row for row, index in enumerate(b.index)}
    pairs = [(row, rows[int(i)]) for row, i in enumerate(a.index) if int(i) in rows]
    mine = [p[0] for p in pairs]
    other = [p[1] for p in pairs]
    same = a.parameters.keys() == b.parameters.keys()
    for name in a.parameters if same else ():
        of_a = a.parameters[name][mine]
        same = same and np.array_equal(of_a, b.parameters[name][other])
    if not pairs or not same or not np.array_equal(a.seed[mine], b.seed[other]):
        raise LogError(
            "the two sweeps have different machines: compare sweeps with the same seed, population"
            " and findings"
        )
    return mine, other
