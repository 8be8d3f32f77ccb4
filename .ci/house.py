"""How dense and how entangled the house is, in numbers that may only get better.

``python .ci/house.py`` prints them beside the baseline in `house.json`; with ``--check`` it fails
where one is worse. ``--write`` makes the present numbers the baseline; where one is worse it asks
for ``--reason TEXT``, which stands in the baseline until the next one.
"""

import argparse
import ast
import io
import json
import re
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path

HERE = Path(__file__).resolve().parent
BASELINE = HERE / "house.json"
PACKAGE = "hilserver"
LONG = 50
"""Lines of a function that no longer fits on a screen."""
INDEX = re.compile(r"[PXYUE]_[A-Z0-9_]+")
"""Names of places in a vector: of parameters, states, outputs, inputs, events."""
CONSTANT = re.compile(r"[A-Z][A-Z0-9_]+")
DENSE = 25
"""AST nodes of an expression that one no longer reads at a glance."""
MORE_IS_BETTER = {"comments_percent"}
UNFELT = 0.005
"""Share of a number by which it may be worse: a line more or less that no reader feels."""
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class File:
    """One module of the package."""

    name: str
    room: str
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        """Its syntax."""
        return ast.parse(self.text)

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of its syntax."""
        return list(ast.walk(self.tree))

    @property
    def lines(self) -> int:
        """Lines that are not blank."""
        return sum(1 for line in self.text.splitlines() if line.strip())


def read(root: Path) -> list[File]:
    """Return all modules of the package; those at the top are rooms of their own."""
    files = []
    for path in sorted((root / PACKAGE).rglob("*.py")):
        parts = path.relative_to(root / PACKAGE).with_suffix("").parts
        name = ".".join((PACKAGE, *parts)).removesuffix(".__init__")
        files.append(File(name, parts[0], path.read_text(encoding="utf-8")))
    return files


def functions(file: File) -> Iterator[Function]:
    """Yield all functions, methods and inner functions too."""
    return (node for node in file.nodes if isinstance(node, Function))


def long_functions(file: File) -> Iterator[str]:
    """Yield the functions that are longer than a screen."""
    for node in functions(file):
        length = (node.end_lineno or node.lineno) - node.lineno + 1
        if length > LONG:
            yield f"{file.name}.{node.name} ({length})"


def size(node: ast.AST) -> int:
    """Return the number of AST nodes below and with `node`."""
    return sum(1 for _ in ast.walk(node))


@dataclass
class Density:
    """What the bodies of functions hold, docstrings left out; an inner function counts twice."""

    nodes: int = 0
    code_lines: int = 0
    statements: int = 0
    expressions: int = 0  # the whole ones, which stand directly in a statement
    dense: int = 0

    def add(self, file: File, function: Function) -> None:
        """Add a function."""
        body = (
            function.body[1:]
            if ast.get_docstring(function) is not None
            else function.body
        )
        if not body:
            return
        rows = file.text.splitlines()[body[0].lineno - 1 : function.end_lineno]
        self.code_lines += sum(
            1 for row in rows if row.strip() and row.strip()[0] != "#"
        )
        for node in (inner for statement in body for inner in ast.walk(statement)):
            self.nodes += 1
            if isinstance(node, ast.stmt):
                self.statements += 1
                whole = [
                    n for n in ast.iter_child_nodes(node) if isinstance(n, ast.expr)
                ]
                self.expressions += len(whole)
                self.dense += sum(1 for expression in whole if size(expression) > DENSE)


def used_once(file: File) -> list[str]:
    """Return the private functions that their module names once."""
    uses: Counter[str] = Counter()
    for node in file.nodes:
        if isinstance(node, ast.Name):
            uses[node.id] += 1
        elif isinstance(node, ast.Attribute):
            uses[node.attr] += 1
    names = (node.name for node in functions(file))
    private = (n for n in names if n.startswith("_") and not n.startswith("__"))
    return [f"{file.name}.{name}" for name in private if uses[name] == 1]


def classes(file: File) -> Iterator[str]:
    """Yield the names of the classes."""
    return (node.name for node in file.nodes if isinstance(node, ast.ClassDef))


def constants(file: File) -> Iterator[tuple[str, str]]:
    """Yield the public upper-case names that a module binds to a number, with the number."""
    for node in file.tree.body:
        if isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets, value = [node.target], node.value
        else:
            continue
        try:
            number = ast.literal_eval(value)
        except ValueError:
            continue
        for target in targets:
            if not isinstance(target, ast.Name) or not isinstance(number, int | float):
                continue
            if CONSTANT.fullmatch(target.id):
                yield target.id, f"{number:g}"


def index_lines(file: File) -> int:
    """Return the lines that do nothing but import index constants."""
    lines: set[int] = set()
    for node in file.nodes:
        if isinstance(node, ast.ImportFrom):
            lines |= {a.lineno for a in node.names if INDEX.fullmatch(a.name)}
    return len(lines)


def imported(file: File, rooms: set[str]) -> set[str]:
    """Return the other rooms that a module knows."""
    found: set[str] = set()
    for node in file.nodes:
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [a.name for a in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{a.name}" for a in node.names]
        for name in names:
            first, _, rest = name.partition(".")
            if first == PACKAGE:
                found.add(rest.partition(".")[0])
    return (found & rooms) - {file.room}


def comments(file: File) -> int:
    """Return the lines that hold a comment and no code."""
    tokens = tokenize.generate_tokens(io.StringIO(file.text).readline)
    return sum(
        1
        for t in tokens
        if t.type == tokenize.COMMENT and t.line.lstrip().startswith("#")
    )


@dataclass(frozen=True)
class House:
    """All numbers, and what stands behind them."""

    numbers: dict[str, float]
    long: list[str]
    two_values: dict[str, set[str]]
    several_classes: dict[str, int]
    once: Counter[str]  # private functions that are used once, by room


def measure(root: Path) -> House:
    """Measure the package below a folder."""
    files = read(root)
    rooms = {f.room for f in files} - {"__init__"}
    arrows = {frozenset((f.room, other)) for f in files for other in imported(f, rooms)}
    pairs = list(combinations(sorted(rooms), 2))
    values: dict[str, set[str]] = defaultdict(set)
    density = Density()
    names: Counter[str] = Counter()
    once: Counter[str] = Counter()
    n_functions = 0
    for file in files:
        names.update(classes(file))
        once[file.room] += len(used_once(file))
        for function in functions(file):
            n_functions += 1
            density.add(file, function)
        for name, literal in constants(file):
            values[name].add(literal)
    long = [name for f in files for name in long_functions(f)]
    two_values = {
        name: found for name, found in sorted(values.items()) if len(found) > 1
    }
    several = {name: count for name, count in names.most_common() if count > 1}
    joined = sum(1 for pair in pairs if frozenset(pair) in arrows)
    lines = sum(f.lines for f in files)
    numbers: dict[str, float] = {
        "nodes_per_statement": ratio(density.nodes, density.statements),
        "nodes_per_code_line": ratio(density.nodes, density.code_lines),
        "dense_expressions_percent": ratio(100 * density.dense, density.expressions),
        "helpers_used_once_percent": ratio(100 * once.total(), n_functions),
        "names_of_several_classes": len(several),
        "functions_over_50_lines": len(long),
        "names_with_two_values": len(two_values),
        "room_pairs_joined_percent": ratio(100 * joined, len(pairs)),
        "index_import_lines": sum(map(index_lines, files)),
        "comments_percent": ratio(100 * sum(map(comments, files)), lines),
    }
    return House(numbers, long, two_values, several, once)


def ratio(part: float, whole: float) -> float:
    """Return ``part/whole`` with the digits that a reader can use."""
    return round(part / max(whole, 1), 2)


def worse(now: dict[str, float], before: dict[str, float]) -> list[str]:
    """Return a sentence for every number that is worse than before by more than `UNFELT`."""
    found = []
    for name in before.keys() & now.keys():
        loss = now[name] - before[name]
        if name in MORE_IS_BETTER:
            loss = -loss
        if loss > UNFELT * before[name]:
            found.append(f"{name} is {now[name]:g}, it was {before[name]:g}")
    return sorted(found)


def show(house: House, before: dict[str, float]) -> None:
    """Print the numbers beside the baseline, and what stands behind them."""
    for name, value in house.numbers.items():
        print(f"{name:28}{value:10g}{before.get(name, value):10g}")
    found = {
        "functions over 50 lines": house.long,
        "names with two values": [
            f"{name}: {', '.join(sorted(values))}"
            for name, values in house.two_values.items()
        ],
        "names of several classes": [
            f"{n}: {c}" for n, c in house.several_classes.items()
        ],
        "private functions used once, by room": [
            f"{r}: {c}" for r, c in house.once.most_common()
        ],
    }
    for title, rows in found.items():
        print(f"\n{title}", *(f"  {row:.96}" for row in rows), sep="\n")


def main(arguments: list[str] | None = None) -> int:
    """Print, check or write; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="fail where a number is worse"
    )
    parser.add_argument("--write", action="store_true", help="make these the baseline")
    parser.add_argument("--reason", default="", help="why a number may be worse")
    parser.add_argument("--root", type=Path, default=HERE.parent)
    parser.add_argument("--baseline", type=Path, default=BASELINE)
    args = parser.parse_args(arguments)
    house = measure(args.root)
    known = (
        json.loads(args.baseline.read_text("utf-8")) if args.baseline.exists() else {}
    )
    before: dict[str, float] = known.get("numbers", {})
    found = worse(house.numbers, before)
    if args.write:
        if found and not args.reason:
            print(*found, "say why with --reason TEXT", sep="\n", file=sys.stderr)
            return 1
        document = {"numbers": house.numbers, "reason": args.reason}
        args.baseline.write_text(json.dumps(document, indent=2) + "\n", "utf-8")
        return 0
    if args.check:
        if found:
            print(
                *found,
                "Make it better, or commit a new baseline with the reason:"
                " python .ci/house.py --write --reason TEXT",
                sep="\n",
                file=sys.stderr,
            )
        return 1 if found else 0
    show(house, before)
    return 0


if __name__ == "__main__":
    sys.exit(main())
