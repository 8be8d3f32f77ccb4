"""One changed line in a function of the engine, for as long as a test wants it."""

import inspect
import textwrap
from contextlib import contextmanager


@contextmanager
def mutated(function, line, changed):
    """Run the function with `changed` in the place of `line`, wherever it is called from."""
    source = textwrap.dedent(inspect.getsource(function))
    assert source.count(line) == 1, (
        f"{function.__name__} has changed: where is '{line}'?"
    )
    namespace = dict(function.__globals__)
    exec(
        compile(source.replace(line, changed), inspect.getfile(function), "exec"),
        namespace,
    )
    original = function.__code__
    function.__code__ = namespace[function.__name__].__code__
    try:
        yield
    finally:
        function.__code__ = original
