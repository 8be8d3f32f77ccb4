"""Lives of the town from the command line: ``python -m tests.hours 17`` repeats seed 17.

``python -m tests.hours 0:1000`` lives a thousand; the town is built once, and forked for each.
With ``--journal FILE`` it goes on where it was interrupted.
"""

import argparse
import gc
import json
import os
import pickle
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any


def main() -> int:
    """Live the seeds asked for; return 1 if the judges found something."""
    parser = argparse.ArgumentParser(prog="python -m tests.hours")
    parser.add_argument("seeds", help="one number, or first:end")
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated, for each seed")
    parser.add_argument("--mode", default="poll", help="how the controller is read")
    parser.add_argument("--mutant", help="plant a fault of the product first")
    parser.add_argument("--journal", type=Path, help="keep results here; what is there is done")
    parser.add_argument("--until-found", action="store_true", help="end with the first breach")
    parser.add_argument("--story", action="store_true", help="print what the daemon said")
    options = parser.parse_args()
    if os.environ.get("PYTHONHASHSEED") != "0":  # sets of names have an order then
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
    from tests.hours.loop import run_in  # noqa: PLC0415
    from tests.hours.mutants import plant  # noqa: PLC0415
    from tests.hours.town import Town  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        clock.seed(0)
        town = Town(Path(folder), options.mode)
        if options.mutant:
            plant(options.mutant)
        run_in(town.loop, town.start())
        try:
            return _live(town, seeds, options)
        finally:
            town.daemon.core.close()


def _live(town: Any, seeds: range, options: argparse.Namespace) -> int:
    simulated_s = cpu_s = 0.0
    bad, journal = 0, options.journal
    done: dict[int, dict[str, Any]] = {}
    if journal is not None and journal.exists():
        results = map(json.loads, journal.read_text(encoding="utf-8").splitlines())
        done = {result["seed"]: result for result in results}
    for seed in seeds:
        result = done.get(seed) or _forked(town, seed, options)
        if journal is not None and seed not in done:
            with journal.open("a", encoding="utf-8") as file:
                print(json.dumps(result), file=file)
        simulated_s, cpu_s = simulated_s + result["simulated_s"], cpu_s + result["cpu_s"]
        bad += bool(result["found"])
        print(f"seed {seed} {result.get('digest', '')}", flush=True)
        if result["found"] or len(seeds) == 1:
            print(json.dumps(result), flush=True)
        if bad and options.until_found:
            break
    pace = simulated_s / max(cpu_s, 1e-9)
    print(
        f"{len(seeds)} seeds, {bad} with a breach; {simulated_s:.0f} s simulated, {pace:.1f} per"
        " second of processor time"
    )
    return min(bad, 1)


def _forked(town: Any, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Live one seed in a process of its own."""
    reading, writing = os.pipe()
    child = os.fork()
    if child:
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            data = pipe.read()
        os.waitpid(child, 0)
        return (
            pickle.loads(data)
            if data
            else {"seed": seed, "found": ["died"], "simulated_s": 0, "cpu_s": 0}
        )
    try:
        os.close(reading)
        from tests.hours.life import Life  # noqa: PLC0415

        life = Life(town, seed, options.seconds)
        result = life.run()
        with os.fdopen(writing, "wb") as pipe:
            pickle.dump(vars(result), pipe)
        if options.story:
            for at_s, line in town.lines:
                print(f"{at_s - life.begun_s:.3f} {line}", file=sys.stderr)
            for line in life.story():
                print(line, file=sys.stderr)
    except BaseException:  # noqa: BLE001 - a fork must never go on as its parent
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(0)


if __name__ == "__main__":
    start_s = time.process_time()
    sys.exit(main())
