"""The step in pieces, so that several processes can compile what it calls side by side.

A piece is never executed: it calls a part of the robot with the same types as the step does.
"""

import ast
from collections.abc import Iterator


def pieces(source: str) -> list[str]:
    """Return modules with a function ``step`` each, which have one branch, or a part of one."""
    tree = ast.parse(source)
    function = next(node for node in tree.body if isinstance(node, ast.FunctionDef))
    (decorator,) = function.decorator_list
    assert isinstance(decorator, ast.Call)
    decorator.keywords.append(ast.keyword("cache", ast.Constant(value=False)))
    *branches, _ = function.body
    found = []
    for branch in branches:
        assert isinstance(branch, ast.If)
        for part in _parts(branch.body):
            branch.body = part
            function.body = [branch, ast.Return(ast.Constant(0))]
            found.append(ast.unparse(ast.fix_missing_locations(tree)))
    return found


def _parts(branch: list[ast.stmt]) -> Iterator[list[ast.stmt]]:
    """Yield each call whose result nobody uses, and the rest, if it calls anything."""
    alone: list[ast.stmt] = [line for line in branch if isinstance(line, ast.Expr)]
    yield from ([line] for line in alone)
    rest = [line for line in branch if line not in alone]
    if any(isinstance(node, ast.Call) for line in rest for node in ast.walk(line)):
        yield rest
