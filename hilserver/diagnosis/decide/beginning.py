"""Where a search begins: at the configuration, or at terms that already run."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hilserver.diagnosis.catalogue.candidate import Candidate, Theta
from hilserver.diagnosis.decide.identifiability import prune
from hilserver.diagnosis.decide.trial import at_bound
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.fitting import fit, fit_without
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Fitted, Model

Terms = Mapping[str, float]


def begun(
    problem: Problem,
    library: Library,
    base: Point,
    terms: Terms,
    barred: Collection[str] = (),
) -> Point:
    """Return the model of the terms that already run, with values estimated from these data.

    Terms that the data do not show, or that belong to no cause, are left out.

    Parameters
    ----------
    terms : mapping of str to float
        Total values by term.
    barred : collection of str
        Causes that it must not contain.
    """
    model = Model()
    for f in causes_of(library.candidates, terms):
        if f.candidate.cause not in barred:
            model = model.plus(f.candidate, f.theta)
    if not model.fitted:
        return base
    point = fit(problem, model, base, iterations=12)
    while gone := [i for i, f in enumerate(point.model.fitted) if at_bound(f)]:
        point = fit_without(problem, point, *gone)
    return prune(problem, point)


def causes_of(candidates: Sequence[Candidate], terms: Terms) -> Iterator[Fitted]:
    """Yield causes that reproduce the running terms; those that set the most terms come first."""
    left = dict(terms)
    for c in sorted(candidates, key=lambda c: -len(c.terms(c.start))):
        names = list(c.terms(c.start))
        if left.keys() >= set(names):
            yield _as_it_runs(c, {name: left.pop(name) for name in names})


def _as_it_runs(c: Candidate, own: Terms) -> Fitted:
    """Return a cause at given values; terms that only shape it stay as given.

    Parameters
    ----------
    own : mapping of str to float
        By term, in the candidate's order: the fitted ones first.
    """
    values = list(own.values())
    theta = tuple(values[: c.n])
    shape = dict(list(own.items())[c.n :])
    made = c.terms(theta)
    if c.n == len(own) and not np.allclose(list(made.values()), values):
        size, phase = values  # of a wave, which is fitted as cosine and sine
        theta = (size * float(np.cos(phase)), size * float(np.sin(phase)))
    if all(made[name] == value for name, value in shape.items()):
        return Fitted(c, theta)

    def terms(theta: Theta) -> dict[str, float]:
        return {**c.terms(theta), **shape}

    label = f"{c.cause}, as it runs"
    return Fitted(replace(c, label=label, terms=terms, moved=None, region=None), theta)
