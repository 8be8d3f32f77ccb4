"""The start of `hilserver run` up to the compiled step, in children: they fill the cache.

``python -m hilserver.commands.compiled_start [-c FILE] [--patch FILE] [--group NAME]
[--alone | --helper] PARENT``
"""

import argparse
import contextlib
import dataclasses

from hilserver.commands.options import add_config, add_patch
from hilserver.compiled import sharing
from hilserver.compiled.cache import shelf, supplied
from hilserver.program import children, compiling


def commands(args: argparse.Namespace) -> list[list[str]]:
    """Return the command lines of the children for the arguments of `run`, without their parent.

    The first one compiles all, the others help. Where a step is kept, another one finds most of its
    parts: one child compiles the rest with half the work, and as soon.
    """
    given = {"--config": args.config, "--patch": args.patch, "--group": args.group}
    words = [f"{name}={value}" for name, value in given.items() if value is not None]
    command = children.python("-m", __name__, *words)
    folders = shelf().folder, supplied().folder
    if any(any(folder.glob("step_*.nbc")) for folder in folders):
        return [[*command, "--alone"]]
    return [command, *[[*command, "--helper"]] * (compiling.processes() - 1)]


def _main() -> None:
    parser = argparse.ArgumentParser()
    add_config(parser)
    add_patch(parser)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--helper", action="store_true")
    parser.add_argument("parent", type=int)
    args = parser.parse_args()
    compiling.as_child(lambda: _build(args), args.parent)


def _build(args: argparse.Namespace) -> None:
    share = sharing.shared(shelf, is_helper=args.helper)
    with contextlib.nullcontext() if args.alone else share:
        import hilserver.commands.running  # noqa: PLC0415 - compiles
        from hilserver.commands.patching import assembled  # noqa: PLC0415
        from hilserver.daemon.builder import UNDEMANDING, Pace, build  # noqa: PLC0415

        assembly = assembled(args)
        if assembly.config.shield.enabled:
            import hilserver.io.shield.wire  # noqa: F401, PLC0415 - compiles, too
        pace = dataclasses.replace(
            Pace.configured(assembly), image="", realtime=UNDEMANDING
        )
        build(assembly, pace).close()


if __name__ == "__main__":
    _main()
