"""What is known about the shield and its host: a peer's status with additions."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hilserver.io.link_status import PeerStatus
from hilserver.io.shield import words as w
from hilserver.io.shield.protocol import NAMES

NAME = "shield"


@dataclass(slots=True)
class ShieldStatus(PeerStatus):
    """Everything observed on the serial line."""

    # counters of the line's thread, see `words`
    words: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(w.N_WORDS, dtype=np.int64)
    )
    # the host has enabled the motors and has not been silent since
    enabled: bool = False
    # requests that are echoed and change nothing in the simulation
    without_effect: int = 0
    # name of a command -> number of requests
    requests: Counter[str] = field(
        default_factory=lambda: Counter(dict.fromkeys(NAMES, 0))
    )
    # values that the host has set and the robot stores
    parameters: dict[str, float] = field(default_factory=dict)

    @property
    def raw_imu(self) -> bool:
        """Whether responses hold raw values of the IMU."""
        return bool(self.words[w.RAW])

    def count(self, word: int) -> int:
        """Return a counter of the line's thread."""
        return int(self.words[word])

    @property
    def figures(self) -> dict[str, float | str | bool | int | None]:
        """What OPC UA shows in addition to a peer's figures."""
        responses = self.count(w.RESPONSES)
        return {
            "enabled": self.enabled,
            "raw_imu": self.raw_imu,
            "requests": self.count(w.REQUESTS),
            "responses": responses,
            "without_effect": self.without_effect,
            "skipped_bytes": self.count(w.SKIPPED),
            "unterminated": self.count(w.UNTERMINATED),
            "unanswered": self.count(w.UNANSWERED),
            "unread_bytes": self.count(w.UNREAD),
            "lateness_mean_us": self.count(w.LATE_SUM) / responses * 1e-3
            if responses
            else None,
            "lateness_max_us": self.count(w.LATE_MAX) * 1e-3 if responses else None,
            "parameters": ", ".join(
                f"{k} {v:g}" for k, v in sorted(self.parameters.items())
            ),
        }
