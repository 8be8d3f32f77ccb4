"""How much better any model could be: a flexible regression on all directions at once."""

from typing import Final

import numpy as np

from hilserver.diagnosis.findings.worth import MemberStage
from hilserver.diagnosis.regression.gain import gains
from hilserver.diagnosis.regression.stages import of_the_other_half

DIGITS: Final = 5  # further digits depend on how many threads share its large products


def ceilings(
    part: MemberStage, horizon_s: float, rng: np.random.Generator
) -> dict[str, float]:
    """Return the held-out ratio that a ridge regression on all columns reaches, by quantity.

    The base is the model; the effects are taken as linear there.
    """
    library, point = part.judged.prepared.library, part.judged.point
    library.rewhiten(point)
    after = point.predicted + of_the_other_half(part.problem, library, point)
    reached = gains(part.problem, part.before, after, horizon_s, rng)
    return {key: float(f"{gain.ratio:.{DIGITS}g}") for key, gain in reached.items()}
