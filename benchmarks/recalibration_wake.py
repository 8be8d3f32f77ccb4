"""Effect of a diagnosis beside the daemon on pacing: blocks with and without one alternate.

The daemon serves the OPC UA clients of `bench jitter` all the time. A process with the default
share of a look diagnoses one window repeatedly; it is stopped during blocks without diagnosis.
"""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from hilserver_injector import Recipe, make

from benchmarks.tune import alternating
from hilserver.bench.jitter_subjects import Companion, Place
from hilserver.bench.report import Result
from hilserver.config.recalibration import RecalibrationConfig
from hilserver.config.root import Config, without_passwords
from hilserver.errors import FailedError
from hilserver.program.children import piped, python
from hilserver.recalibration import process
from hilserver.recalibration.judging import OrderJudge
from hilserver.recalibration.orders import JudgeOrder, Share, Todo
from hilserver.recalibration.worker import take

WINDOW_S: Final = 120.0
HIDDEN: Final = {"rotation_gain": 0.06}


def wake(args: argparse.Namespace) -> list[Result]:
    """Measure; return the ratio of the percentiles with its interval."""
    looks = Looks()
    company = Companion("control", lambda _: {"source": "opcua"}, looks.busy)
    return alternating("look", company, looks.say, args)


class Looks:
    """A process that diagnoses while it is asked to."""

    @contextlib.contextmanager
    def busy(self, place: Place) -> Iterator[str]:
        """Run it; its first look ends before the context begins, so all is compiled by then."""
        order = place.folder / process.ORDER
        order.write_text(self.order(place).text(), encoding="utf-8")
        with piped(
            python("-m", "benchmarks.recalibration_wake", str(order)), name="the looks"
        ) as self._process:
            self._awaited()
            try:
                yield f"windows of {WINDOW_S:g} s diagnosed in every second block"
                self.say("change")
                self._awaited()
            finally:
                self.say("change")  # a stopped process cannot end

    @staticmethod
    def order(place: Place) -> JudgeOrder:
        """Write a window; return the order to look at it, with the default share."""
        window, config = place.folder / "window.csv", RecalibrationConfig()
        make(Recipe(seed=1, causes=HIDDEN, duration_s=WINDOW_S))[0].write_csv(window)
        cores = process.other_cores(place.pacing_thread, config.cpu)
        share = Share(config.nice, cores, round(config.memory_mb * 1e6), os.getpid())
        plain = without_passwords(Config())
        return JudgeOrder(
            Todo(1, {}, look=True), str(window), plain, str(place.folder), {}, "", share
        )

    def _awaited(self) -> None:
        own: subprocess.Popen[str] = self._process
        assert own.stdout is not None
        if (verdict := own.stdout.readline().strip()) != "named":
            raise FailedError(
                f"a look beside the daemon found {verdict or 'nothing, and ended'}"
            )

    def say(self, order: str) -> None:
        """Let it continue, or rest."""
        os.kill(
            self._process.pid, signal.SIGSTOP if order == "rest" else signal.SIGCONT
        )


def main() -> None:
    """Look at a window repeatedly; print each verdict."""
    order = JudgeOrder.of(Path(sys.argv[1]).read_text(encoding="utf-8"))
    take(order.share)
    while True:
        result = OrderJudge(order).result()
        print(result.error if result.look is None else result.look.verdict, flush=True)


if __name__ == "__main__":
    main()
