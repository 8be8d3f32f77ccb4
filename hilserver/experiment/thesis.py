"""What the experiments of chapter 5 were, and which figures of the thesis show them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from hilserver.errors import FailedError, meant

ROBOT: Final = "robot.yaml"
POSE: Final = ("x", "y", "yaw")
TURN: Final = ("turn", "yaw")


class Experiment(NamedTuple):
    """One experiment."""

    name: str  # its section
    title: str
    was: str  # how the thesis did it, and what for
    # numbers of the thesis's figures, by what they show: wheels, left, right, x, y, path, yaw, turn
    figures: Mapping[str, str]
    channels: tuple[str, ...]  # in which the models are compared with the robot
    identifies: bool  # whether it identifies single figures, as all of section 5.2 does

    @property
    def drive(self) -> Path:
        """The scenario that drives it, as `hilserver simulate` and the daemon play it."""
        return folder() / f"{self.name}.yaml"


EXPERIMENTS: Final[Mapping[str, Experiment]] = {
    experiment.name: experiment
    for experiment in (
        Experiment(
            "5.2.1",
            "turns on the spot",
            "The thesis turned the robot on the spot at several speeds, in both directions, on four"
            " floors. It recorded the actual speeds of the wheels and the turn rate of the IMU, and"
            " concluded that front and rear wheels turn alike, which sign belongs to which"
            " direction, and K_om by (5.19).",
            {"left": "5.4", "right": "5.8", "turn": "5.11"},
            TURN,
            identifies=True,
        ),
        Experiment(
            "5.2.2",
            "turns on the spot at steady set-points, and steps of the drive",
            "The thesis repeated 5.2.1 with set-points and stamps, used only the samples near a"
            " steady set-point, and identified the drive (5.23) by Strejc's method.",
            {},
            TURN,
            identifies=True,
        ),
        Experiment(
            "5.6.1",
            "separate movements: straight lines and turns on the spot",
            "The thesis drove straight lines and turns on the spot on the concrete floor of a hall,"
            " with an input that changed quickly, and compared both models with the pose of a Pozyx"
            " tag. Both were fed with the wheel speeds of the recording; K_om is (5.9).",
            {
                "wheels": "5.37 to 5.40",
                "x": "5.41",
                "y": "5.42",
                "path": "5.43",
                "yaw": "5.44",
            },
            POSE,
            identifies=False,
        ),
        Experiment(
            "5.6.2",
            "out a little, then in a circle",
            "The thesis drove out a little and then in a circle, with linear and angular speed"
            " together, so that the inner wheels nearly stood and slid. Both models were fed with"
            " the wheel speeds of the recording; K_om is (5.9).",
            {
                "wheels": "5.45 to 5.48",
                "x": "5.49",
                "y": "5.50",
                "path": "5.51",
                "yaw": "5.52",
            },
            POSE,
            identifies=False,
        ),
    )
}


def experiment_of(name: str) -> Experiment:
    """Return an experiment by its section; FailedError if there is none of this name."""
    if name in EXPERIMENTS:
        return EXPERIMENTS[name]
    hint = meant(name, EXPERIMENTS, f"there are {', '.join(EXPERIMENTS)}.")
    raise FailedError(f"no experiment is called {name!r}; {hint}")


def folder() -> Path:
    """Return the folder of the scenarios: ``examples/thesis`` of a checkout, see setup.py."""
    installed = Path(__file__).parent / "drives"
    if installed.exists():
        return installed
    return Path(__file__).parents[2] / "examples" / "thesis"
