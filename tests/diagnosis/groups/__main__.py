"""The table of one machine on two floors: what is shared, what is free, and the joint ellipsoid.

``python -m tests.diagnosis.groups --results FILE`` runs what FILE has no line for yet. In half of
the cases the floor's cause differs, in the other half the machine's: it was loaded in between.
"""

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hilserver_injector import Recipe, make
from scipy import stats

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.engine import diagnose_groups
from tests.diagnosis.assertions import LARGEST_GROUP, said
from tests.diagnosis.hidden.logs import assembly

OF_THE_FLOOR = {
    "rotation_gain": 0.03, "rotation_gain_speed": 0.2, "longitudinal_slip": 0.12, "side_slip": 0.15
}  # fmt: skip
OF_THE_MACHINE = {
    "wheel_radius_difference": 0.02, "nav_latency": 0.1, "imu_latency": 0.05, "gyro_scale": 0.03
}  # fmt: skip
ONE_SIGN = {"longitudinal_slip", "nav_latency", "imu_latency"}
GROUPS = ("asphalt", "sand")
SECONDS = 180.0
SHARE = 0.9
"""Of the joint ellipsoid."""


@dataclass(frozen=True)
class Case:
    """Two causes; one has another size on the second floor.

    Attributes
    ----------
    truth : mapping of str to mapping of str to float
        By floor, by cause.
    """

    number: int
    differs: str
    shared: str
    truth: dict[str, dict[str, float]]

    @classmethod
    def draw(cls, number):
        """Draw a case: sizes of 1.5 to 2.5 times the reference, and as much between the floors."""
        rng = np.random.default_rng(77_000 + number)
        names = [
            str(rng.choice(list(OF_THE_FLOOR))),
            str(rng.choice(list(OF_THE_MACHINE))),
        ]
        differs, shared = names if number % 2 == 0 else names[::-1]
        reference = OF_THE_FLOOR | OF_THE_MACHINE
        signs = {
            name: 1.0 if name in ONE_SIGN else rng.choice([-1.0, 1.0]) for name in names
        }
        first = {
            n: float(signs[n] * rng.uniform(1.5, 2.5) * reference[n]) for n in names
        }
        step = float(signs[differs] * rng.uniform(1.5, 2.5) * reference[differs])
        second = first | {differs: first[differs] + step}
        return cls(
            number, differs, shared, dict(zip(GROUPS, (first, second), strict=True))
        )

    def logs(self):
        """Return both logs."""
        recipes = {
            name: Recipe(
                seed=2 * (77_000 + self.number) + k, causes=causes, duration_s=SECONDS
            )
            for k, (name, causes) in enumerate(self.truth.items())
        }
        return {name: measured(make(one)[0]) for name, one in recipes.items()}


def is_right(case, findings):
    """Whether both causes have names of their own, and the one is free that differs."""
    free = {}
    for found in findings.findings:
        own = {case.differs, case.shared} & set(found.causes)
        if len(own) != 1 or len(found.causes) > LARGEST_GROUP:
            return False
        (cause,) = own
        free[cause] = found.parameters[cause].groups is not None
    return free == {case.differs: True, case.shared: False}


def holds_truth(case, joint):
    """Whether the ellipsoid of 90 % holds the truth; None where its parameters are others."""
    if joint is None:
        return None
    first = case.truth[GROUPS[0]]
    truth = {
        f"{case.differs}@{name}": causes[case.differs]
        for name, causes in case.truth.items()
    }
    truth[case.shared] = first[case.shared]
    if set(joint.parameters) != set(truth):
        return None
    away = np.array(joint.value) - [truth[name] for name in joint.parameters]
    distance = float(away @ np.linalg.solve(np.array(joint.covariance), away))
    return bool(distance <= stats.chi2.ppf(SHARE, len(away)))


def main():
    """Run the open cases; say how many are right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--results", type=Path, required=True, help="one line of JSON per case"
    )
    parser.add_argument(
        "--cases", type=int, default=40, metavar="N", help="default %(default)s"
    )
    args = parser.parse_args()
    lines = args.results.read_text().splitlines() if args.results.exists() else []
    done = {record["case"]: record for record in map(json.loads, lines)}
    with args.results.open("a") as out:
        for case in map(Case.draw, range(args.cases)):
            if case.number in done:
                continue
            begun = time.monotonic()
            findings = diagnose_groups(case.logs(), assembly(), jobs=1).findings
            record = {
                "case": case.number,
                "differs": case.differs,
                "shared": case.shared,
                "right": is_right(case, findings),
                "ellipsoid": holds_truth(case, findings.joint),
                "found": said(findings),
                "seconds": round(time.monotonic() - begun, 1),
            }
            done[case.number] = record
            out.write(json.dumps(record) + "\n")
            out.flush()
            print(f"{case.number + 1} of {args.cases}: {record}", file=sys.stderr)
    records = [done[number] for number in range(args.cases)]
    held = [
        record["ellipsoid"] for record in records if record["ellipsoid"] is not None
    ]
    print(f"{sum(record['right'] for record in records)} of {len(records)} right")
    print(f"{sum(held)} of {len(held)} joint ellipsoids of {SHARE:.0%} hold the truth")


if __name__ == "__main__":
    main()
