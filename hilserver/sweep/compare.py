"""Two controllers on the same machines, machine by machine."""

import numpy as np

from hilserver.errors import LogError
from hilserver.sweep.estimates import LEAST_MACHINES, median_interval, paired_p
from hilserver.sweep.table import PASSED, Table


def compare(a: Table, b: Table) -> str:
    """Return what differs between two sweeps of the same machines, as text.

    LogError if the machines differ.
    """
    mine, other = _shared(a, b)
    passed_a, passed_b = (
        np.array([t.status[row] == PASSED for row in rows], dtype=bool)
        for t, rows in ((a, mine), (b, other))
    )
    only_a, only_b = int((passed_a & ~passed_b).sum()), int((~passed_a & passed_b).sum())
    both = int((passed_a & passed_b).sum())
    lines = [
        f"{len(mine)} machines, the same in both",
        f"pass in both {both}, only in A {only_a}, only in B {only_b},"
        f" in neither {len(mine) - both - only_a - only_b}",
        f"by chance so uneven with probability {paired_p(only_a, only_b):.3g} (McNemar, exact)",
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
            f"{name}: margin in B minus A {median:.4g} in the median ({low:.4g} .. {high:.4g}),"
            f" larger on {(change > 0).mean():.1%}"
        )
    return "\n".join(lines)


def _shared(a: Table, b: Table) -> tuple[list[int], list[int]]:
    """Return the rows of the machines that both have."""
    rows = {int(index): row for row, index in enumerate(b.index)}
    pairs = [(row, rows[int(i)]) for row, i in enumerate(a.index) if int(i) in rows]
    mine, other = [p[0] for p in pairs], [p[1] for p in pairs]
    same = set(a.parameters) == set(b.parameters) and all(
        np.array_equal(values[mine], b.parameters[name][other])
        for name, values in a.parameters.items()
    )
    if not pairs or not same or not np.array_equal(a.seed[mine], b.seed[other]):
        raise LogError(
            "the two sweeps have different machines: compare sweeps with the same seed, population"
            " and findings"
        )
    return mine, other
