"""Which parameters all groups share, and which are free by group.

Every group is fitted on its own; its estimate and robust covariance contain all that its logs know
of the parameters. Combining them is generalised least squares with one unknown per shared parameter
and one per group for a free one, so that each way to split the parameters is a small solve.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from hilserver.arrays import Array, Indices, Mask


@dataclass(frozen=True)
class GroupFit:
    """The parameters of one group, fitted on its own."""

    value: Array  # shape (k,)
    known: Mask  # shape (k,): whether its logs show a parameter at all
    covariance: Array  # shape (k, k): robust; only the known rows and columns count
    dof: Array  # shape (k,): degrees of freedom of each variance

    @property
    def weight(self) -> Array:
        """Inverse of the covariance without its bias; zero for parameters that are not known.

        The inverse of a covariance from few blocks is too large on average (Wishart).
        """
        out = np.zeros_like(self.covariance)
        known = np.flatnonzero(self.known)
        if len(known):
            place = np.ix_(known, known)
            dof = float(self.dof[known].max())  # runs only make single variances larger
            out[place] = _inverse(self.covariance[place]) * max(
                1.0 - (len(known) + 1) / dof, 0.1
            )
        return out


@dataclass(frozen=True)
class Together:
    """Parameters of all groups, some of them shared."""

    value: Array  # shape (groups, k)
    # shape (groups, k, k): of each group's parameters, with what the others know of shared ones
    covariance: Array
    # squared distance to the groups' own estimates, weighted by their covariances
    misfit: float
    free: Mask  # shape (k,)
    # shape (groups, k): index of the unknown for each parameter of a group
    places: Indices
    # shape (m, m): covariance of all unknowns; 0 for what no group shows
    unknowns: Array


def together(fits: Sequence[GroupFit], free: Mask) -> Together:
    """Estimate the parameters of all groups; those that are not free are the same in each."""
    n_groups = len(fits)
    places = [_places(g, free) for g in range(n_groups)]
    size = int((~free).sum()) + n_groups * int(free.sum())
    information, target = np.zeros((size, size)), np.zeros(size)
    for fit, place in zip(fits, places, strict=True):
        weight = fit.weight
        information[np.ix_(place, place)] += weight
        target[place] += weight @ np.where(fit.known, fit.value, 0.0)
    covariance = _inverse(information)
    best = covariance @ target
    value = np.stack([best[place] for place in places])
    known = np.stack([fit.known for fit in fits])
    for j in np.flatnonzero(
        free
    ):  # a group that does not show it gets the mean of the others
        if known[:, j].any():
            value[~known[:, j], j] = value[known[:, j], j].mean()
    misfit = 0.0
    for fit, own in zip(fits, value, strict=True):
        away = np.where(fit.known, fit.value - own, 0.0)
        misfit += float(away @ fit.weight @ away)
    parts = np.stack([covariance[np.ix_(place, place)] for place in places])
    return Together(value, parts, misfit, free.copy(), np.stack(places), covariance)


def _places(group: int, free: Mask) -> Indices:
    """Return the index of the unknown for each parameter of a group."""
    n_shared, n_free = int((~free).sum()), int(free.sum())
    place = np.empty(len(free), dtype=np.int64)
    place[~free] = np.arange(n_shared)
    place[free] = n_shared + group * n_free + np.arange(n_free)
    return place


def _inverse(matrix: Array) -> Array:
    """Invert a covariance or an information matrix of widely different units; 0 where it is 0."""
    scale = np.sqrt(np.diag(matrix))
    used = np.flatnonzero(scale > 0.0)
    out = np.zeros_like(matrix)
    own = scale[used]
    unit = matrix[np.ix_(used, used)] / np.outer(own, own)
    inner = np.linalg.inv(unit + 1e-10 * np.eye(len(used)))
    out[np.ix_(used, used)] = inner / np.outer(own, own)
    return out


def free_parameters(
    fits: Sequence[GroupFit], units: Sequence[Sequence[int]], least: Array, level: float
) -> Mask:
    """Return which parameters differ by group.

    At first all are shared. The one that differs most clearly becomes free, until no other does at
    the family-wise `level`; one that others have made superfluous becomes shared again.

    Parameters
    ----------
    units : sequence of sequences of int
        Parameters that can only be free together, such as the two parts of a wave.
    least : ndarray, shape (k,)
        Smaller differences are not worth reporting.
    """
    free = np.zeros(len(least), dtype=bool)
    while True:
        tests = {}
        for number, unit in enumerate(units):
            if not free[list(unit)].any():
                chance, differ = _test(fits, unit, free)
                if (differ >= least[list(unit)]).any():
                    tests[number] = chance * len(units)
        best = min(tests, key=lambda number: tests[number], default=None)
        if best is None or tests[best] >= level:
            break
        free[list(units[best])] = True
    for unit in units:
        mine = list(unit)
        if free[mine].any():
            free[mine] = False
            free[mine] = _test(fits, unit, free)[0] * len(units) < level
    return free


def _test(
    fits: Sequence[GroupFit], unit: Sequence[int], free: Mask
) -> tuple[float, Array]:
    """Return the p of some parameters not differing, and how far their values lie apart."""
    mine = list(unit)
    knowing = [fit for fit in fits if fit.known[mine].all()]
    if len(knowing) < 2:
        return 1.0, np.zeros(len(mine))
    freed = free.copy()
    freed[mine] = True
    apart = together(fits, freed)
    gained = together(fits, free).misfit - apart.misfit
    freedom = (len(knowing) - 1) * len(mine)
    variances = np.array([np.diag(fit.covariance)[mine] for fit in knowing])
    dofs = np.array([fit.dof[mine] for fit in knowing])
    dof = float((variances.sum(axis=0) ** 2 / (variances**2 / dofs).sum(axis=0)).min())
    values = np.array(
        [v for v, fit in zip(apart.value, fits, strict=True) if fit.known[mine].all()]
    )
    return float(stats.f.sf(gained / freedom, freedom, dof)), np.ptp(
        values[:, mine], axis=0
    )
