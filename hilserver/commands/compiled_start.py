"""The start of `hilserver run` up to the compiled step, in a child: it fills the cache.

``python -m hilserver.commands.compiled_start [-c FILE] [--patch FILE] [--group NAME] PARENT``
"""

import argparse
import dataclasses

from hilserver.commands.options import add_config, add_patch
from hilserver.program import children, compiling


def command(args: argparse.Namespace) -> list[str]:
    """Return the command line of the child for the arguments of `run`, without its parent."""
    given = {"--config": args.config, "--patch": args.patch, "--group": args.group}
    words = [f"{name}={value}" for name, value in given.items() if value is not None]
    return children.python("-m", __name__, *words)


def _main() -> None:
    parser = argparse.ArgumentParser()
    add_config(parser)
    add_patch(parser)
    parser.add_argument("parent", type=int)
    args = parser.parse_args()
    compiling.as_child(lambda: _build(args), args.parent)


def _build(args: argparse.Namespace) -> None:
    import hilserver.commands.running  # noqa: PLC0415 - compiles
    from hilserver.commands.patching import assembled  # noqa: PLC0415
    from hilserver.daemon.builder import UNDEMANDING, Pace, build  # noqa: PLC0415

    assembly = assembled(args)
    pace = dataclasses.replace(Pace.configured(assembly), image="", realtime=UNDEMANDING)
    build(assembly, pace).close()
    if assembly.config.shield.enabled:
        import hilserver.io.shield.wire  # noqa: F401, PLC0415 - compiles, too


if __name__ == "__main__":
    _main()
