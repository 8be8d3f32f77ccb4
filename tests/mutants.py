"""Two hundred small faults of the product, each against the tests of its room.

``python -m tests.mutants build/mutants`` draws them (`--seed`, `--mutants`), tries one after the
other in a copy of the committed tree, and prints which ones no test has noticed; called again it
goes on where it was stopped. A room's tests are run without a fault first: they have to pass, and a
mutant is given three times as long, at least `LEAST_S`. A mutant that hangs counts as noticed.

Needs ``pip install cosmic-ray``, and hours: not in ``make test``.
"""

import argparse
import json
import os
import random
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

try:
    from cosmic_ray.ast import ast_nodes, get_ast_from_path
    from cosmic_ray.mutating import mutate_and_test
    from cosmic_ray.plugins import get_operator, operator_names
    from cosmic_ray.testing import TestOutcome, run_tests
    from cosmic_ray.work_db import WorkDB, use_db
    from cosmic_ray.work_item import MutationSpec, WorkItem
except ImportError:
    sys.exit("the mutants are made by cosmic-ray: pip install cosmic-ray")

ROOMS = ("plant", "scheduler", "image", "core", "opcua", "io", "diagnosis")
LEAST_S, BASELINE_S = 60.0, 1800.0
HOME = Path(__file__).parents[1]
NOT_TRIED = (
    "BitOr",  # nearly all of them are types
    "RemoveDecorator",  # a kernel that is not compiled, a class that is no dataclass
)


def git(*words: str) -> bytes:
    """Return what git says of the checkout."""
    return subprocess.run(
        ["git", *words], cwd=HOME, check=True, capture_output=True
    ).stdout


def copied(tree: Path, commit: Path) -> None:
    """Copy the tree of the commit that the mutants were drawn from, without the one tried last.

    And what `make test-tools` has installed for the tests of its rooms.
    """
    tree.mkdir(parents=True, exist_ok=True)
    if not commit.exists():
        commit.write_bytes(git("rev-parse", "HEAD"))
    archive = git("archive", commit.read_text().strip())
    subprocess.run(["tar", "-x"], cwd=tree, input=archive, check=True)
    for there in (*HOME.glob("build"), *HOME.glob("tests/*/node_modules")):
        if not (here := tree / there.relative_to(HOME)).exists():
            here.symlink_to(there)


def draw(session: WorkDB, n: int, seed: int) -> None:
    """Note equally many mutants of each room; a long file has more of them."""
    rng = random.Random(seed)
    names = [n for n in operator_names() if not any(no in n for no in NOT_TRIED)]
    operators = [
        (n, kind()) for n in names if not (kind := get_operator(n)).arguments()
    ]
    for number, room in enumerate(ROOMS):
        files = sorted(Path("hilserver", room).rglob("*.py"))
        sizes = [file.stat().st_size for file in files]
        share = n * (number + 1) // len(ROOMS) - n * number // len(ROOMS)
        for file in rng.choices(files, sizes, k=share):
            nodes = list(ast_nodes(get_ast_from_path(file)))
            session.add_work_item(drawn(file, nodes, operators, rng))


def drawn(file: Path, nodes: list, operators: list, rng: random.Random) -> WorkItem:
    """Return a fault at one place of a file: first the place, then what may be wrong there."""

    def places(name_and_operator: tuple, node: object) -> list:
        return list(name_and_operator[1].mutation_positions(node))

    while True:
        index = rng.randrange(len(nodes))
        fitting = [each for each in operators if places(each, nodes[index])]
        if fitting:
            break
    chosen = rng.choice(fitting)
    start, end = places(chosen, nodes[index])[0]
    before = sum(len(places(chosen, node)) for node in nodes[:index])
    made = MutationSpec(str(file), chosen[0], before, start, end)
    return WorkItem.single(rng.randbytes(16).hex(), made)


def tests_of(source: Path) -> Path:
    """Return the deepest folder of tests that mirrors the folder of a source."""
    folder = "tests" / source.parent.relative_to("hilserver")
    while not any(folder.glob("test_*.py")):
        folder = folder.parent
    return folder


class Rooms:
    """Whether the tests of a folder pass without a fault, and how long they take."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._known = json.loads(file.read_text()) if file.exists() else {}

    @staticmethod
    def command(folder: Path) -> str:
        return f"{sys.executable} -m pytest -x -q -n0 -p no:cacheprovider {folder}"

    def limit_s(self, folder: Path) -> float | None:
        """Return how long a mutant may take; None where the tests fail without any."""
        if str(folder) not in self._known:
            start_s = time.monotonic()
            outcome, said = run_tests(self.command(folder), BASELINE_S)
            took_s = time.monotonic() - start_s
            passed = outcome == TestOutcome.SURVIVED
            self._known[str(folder)] = took_s if passed else None
            self._file.write_text(json.dumps(self._known))
            print(f"{folder}: {took_s:.0f} s" if passed else f"{folder} fails:\n{said}")
        took_s = self._known[str(folder)]
        return None if took_s is None else max(LEAST_S, 3.0 * took_s)


def change_of(diff: str) -> str:
    """Return the lines that a mutant takes away and brings in."""
    lines = [line for line in diff.splitlines() if line[:1] in "+-"]
    return " => ".join(
        line[1:].strip() for line in lines if line[:3] not in ("---", "+++")
    )


def report(session: WorkDB) -> None:
    """Print how many were noticed in each room, and those that were not."""
    found: dict[str, Counter[str]] = {room: Counter() for room in ROOMS}
    survivors = []
    for item, result in session.completed_work_items:
        (mutation,) = item.mutations
        outcome = str(result.test_outcome.value) if result.test_outcome else "not tried"
        found[Path(mutation.module_path).parts[1]][outcome] += 1
        if result.test_outcome == TestOutcome.SURVIVED:
            place = f"{mutation.module_path}:{mutation.start_pos[0]}"
            survivors.append(f"| {place} | `{change_of(result.diff)}` |")
    print("\n| room | noticed | not noticed | not tried |\n|---|---|---|---|")
    for room, counts in found.items():
        cells = (counts[name] for name in ("killed", "survived", "not tried"))
        print(f"| {room} | {' | '.join(map(str, cells))} |")
    print("\n| not noticed | change |\n|---|---|", *sorted(survivors), sep="\n")


def main() -> None:
    parser = argparse.ArgumentParser(prog="tests.mutants", description=__doc__)
    parser.add_argument("folder", type=Path, help="where it keeps what it has found")
    parser.add_argument("--mutants", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--room", choices=ROOMS, help="only the mutants of one room")
    parser.add_argument("--minutes", type=float, default=600.0, help="stop then")
    parser.add_argument("--report", action="store_true", help="try none, only report")
    given = parser.parse_args()
    folder, end_s = given.folder.resolve(), time.monotonic() + 60.0 * given.minutes
    copied(tree := folder / "tree", folder / "commit")
    os.chdir(tree)
    os.environ |= {
        "PYTHONPATH": str(tree),
        "HILSERVER_CACHE_DIR": str(folder / "cache"),
    }

    rooms = Rooms(folder / "rooms.json")
    with use_db(folder / f"seed-{given.seed}.sqlite", WorkDB.Mode.create) as session:
        if not session.num_work_items:
            draw(session, given.mutants, given.seed)
        for item in () if given.report else session.pending_work_items:
            (mutation,) = item.mutations
            source = Path(mutation.module_path)
            if time.monotonic() > end_s or given.room not in (None, source.parts[1]):
                continue
            if (limit_s := rooms.limit_s(tests_of(source))) is not None:
                command = rooms.command(tests_of(source))
                result = mutate_and_test(item.mutations, command, limit_s)
                session.set_result(item.job_id, result)
                said = getattr(
                    result.test_outcome, "value", result.worker_outcome.value
                )
                print(f"{said} {source}:{mutation.start_pos[0]}", flush=True)
        report(session)


if __name__ == "__main__":
    main()
