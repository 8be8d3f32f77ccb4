"""Lives of the town from the command line: ``python -m tests.hours 17`` repeats seed 17.

``python -m tests.hours 0:1000`` lives a thousand; the town is built once, and forked for each.
With ``--results FILE`` it goes on where it was interrupted, with ``--shrink`` it leaves out of each
life that has a breach what that does not need, and says how to repeat what is left.
"""

import argparse
import contextlib
import gc
import json
import os
import pickle
import re
import sys
import tempfile
import traceback
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any


def main() -> int:
    """Live the seeds asked for; return 1 if the judges found something."""
    parser = argparse.ArgumentParser(prog="python -m tests.hours")
    parser.add_argument("seeds", help="one number, or first:end")
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="simulated, for each seed"
    )
    parser.add_argument("--mode", default="poll", help="how the controller is read")
    parser.add_argument(
        "--mutant", help="plant a fault of the product first; all: one by one"
    )
    parser.add_argument(
        "--results", type=Path, help="keep results here; what is there is done"
    )
    parser.add_argument(
        "--until-found", action="store_true", help="end with the first breach"
    )
    parser.add_argument(
        "--story", action="store_true", help="print what the daemon said"
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="PART",
        help="leave out a user or a kind of fault; may be repeated",
    )
    parser.add_argument(
        "--shrink", action="store_true", help="leave out what a breach does not need"
    )
    options = parser.parse_args()
    if "PYTHONHASHSEED" not in os.environ:  # sets of names have an order then
        os.execve(
            sys.executable,
            [sys.executable, "-m", "tests.hours", *sys.argv[1:]],
            os.environ | {"PYTHONHASHSEED": "0"},
        )
    first, _, last = options.seeds.partition(":")
    seeds = range(int(first), int(last) if last else int(first) + 1)

    from tests.hours import clock  # noqa: PLC0415 - before everything else

    clock.install()
    gc.disable()  # its callbacks look at the clock, and it comes when memory says so
    from tests.hours.life import Life  # noqa: PLC0415
    from tests.hours.loop import run_in  # noqa: PLC0415
    from tests.hours.mutants import MUTANTS, named  # noqa: PLC0415
    from tests.hours.town import Town  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        clock.seed(0)
        town = Town(Path(folder), options.mode)
        run_in(town.loop, town.start())
        lives = _Lives(partial(Life, town), options)
        try:
            if options.mutant != "all":
                return lives.live(seeds, named(options.mutant))
            found = {name: lives.live(seeds, plant) for name, plant in MUTANTS.items()}
            print(f"{sum(found.values())} of {len(found)} mutants found")
            return 0
        finally:
            town.daemon.core.close()


class _Lives:
    """Lives seeds, each in a fork of this process."""

    def __init__(
        self, begin: Callable[[int], Any], options: argparse.Namespace
    ) -> None:
        self._begin, self._options = begin, options

    def live(self, seeds: range, plant: Callable[[Any], None] | None) -> int:
        """Live seeds; return 1 if the judges found something."""
        options = self._options
        simulated_s = cpu_s = 0.0
        n_seeds = bad = 0
        done = self._done()
        for seed in seeds:
            result = done.get(seed)
            if result is None:
                result = self._forked(seed, plant)
                if result["found"] and options.shrink:
                    result["repeat"] = self._shrunk(result, plant)
                self._keep(result)
            simulated_s += result["simulated_s"]
            cpu_s += result["cpu_s"]
            n_seeds, bad = n_seeds + 1, bad + bool(result["found"])
            print(f"seed {seed} {result.get('digest', '')}", flush=True)
            if result["found"] or len(seeds) == 1:
                print(json.dumps(result), flush=True)
            if bad and options.until_found:
                break
        pace = simulated_s / max(cpu_s, 1e-9)
        print(
            f"{n_seeds} seeds, {bad} with a breach; {simulated_s:.0f} s simulated, {pace:.1f} per"
            " second of processor time",
            flush=True,
        )
        return min(bad, 1)

    def _done(self) -> dict[int, dict[str, Any]]:
        """Return what the file of results has of lives like these, by seed."""
        path, found = self._options.results, dict[int, dict[str, Any]]()
        if path is None or not path.exists():
            return found
        for line in path.read_text(encoding="utf-8").splitlines():
            with contextlib.suppress(ValueError):  # the last one may be torn
                result = json.loads(line)
                if result["like"] == self._like:
                    found[result["seed"]] = result
        return found

    def _keep(self, result: dict[str, Any]) -> None:
        if self._options.results is not None:
            with self._options.results.open("a", encoding="utf-8") as file:
                print(json.dumps(result | {"like": self._like}), file=file)

    @property
    def _like(self) -> list[Any]:
        options = self._options
        return [options.mode, options.seconds, options.mutant, options.without]

    def _shrunk(
        self, result: dict[str, Any], plant: Callable[[Any], None] | None
    ) -> str:
        """Leave out part after part while the same is found; return the line that repeats it."""
        seed, left_out = result["seed"], list(self._options.without)
        for part in result["parts"]:
            tried = self._forked(seed, plant, [*left_out, part])
            if _breach(tried) == _breach(result):
                left_out.append(part)
        words = [f"python -m tests.hours {seed} --mode {self._options.mode}"]
        words += [f"--without '{part}'" for part in left_out]
        if self._options.mutant is not None:
            words.append(f"--mutant '{self._options.mutant}'")
        return " ".join(words)

    def _forked(
        self,
        seed: int,
        plant: Callable[[Any], None] | None,
        without: Collection[str] | None = None,
    ) -> dict[str, Any]:
        """Live one seed in a process of its own."""
        options = self._options
        without = options.without if without is None else without
        reading, writing = os.pipe()
        child = os.fork()
        if child:
            os.close(writing)
            with os.fdopen(reading, "rb") as pipe:
                data = pipe.read()
            os.waitpid(child, 0)
            died = {"seed": seed, "found": ["died"], "simulated_s": 0, "cpu_s": 0}
            return pickle.loads(data) if data else died
        try:
            os.close(reading)
            life = self._begin(seed, options.seconds, without)
            if plant is not None:
                plant(life.town)
            result = life.run(until_found=options.until_found or options.shrink)
            with os.fdopen(writing, "wb") as pipe:
                pickle.dump(vars(result), pipe)
            if options.story:
                for line in life.story():
                    print(line, file=sys.stderr)
        except BaseException:  # noqa: BLE001 - a fork must never go on as its parent
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(0)


def _breach(result: dict[str, Any]) -> str:
    """Return the first sentence of the judges without times, numbers and names of users."""
    first = next(iter(result["found"]), "")
    return re.sub(
        r"(program|terminal|browser|engineer|stranger|panel)|[\d.]+", "", first
    )


if __name__ == "__main__":
    sys.exit(main())
