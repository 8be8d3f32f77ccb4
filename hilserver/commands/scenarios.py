"""The drives of which the thesis says that its simulation gets them wrong, as sealed logs.

'make' writes logs, configuration and, apart from them, the truth. Diagnose first, then open it.
"""

import argparse
import sys

from hilserver.commands.checkout import beside
from hilserver.commands.options import add_out
from hilserver.errors import EXIT_DONE, FailedError
from hilserver.program.progress import Progress
from hilserver.scenarios import SCENARIOS, scenario
from hilserver.scenarios.making import AGAINST, CONFIG, LOGS, SEALED, write

EXAMPLE = "hilserver scenarios make pulls_aside -o pulls_aside"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``list``, ``make`` and ``page``."""
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    listing = actions.add_parser(
        "list",
        help="list the names, and what the thesis says",
        epilog="example: hilserver scenarios list",
    )
    listing.set_defaults(action=_list)
    making = actions.add_parser(
        "make",
        help="write the logs of one",
        epilog="example: hilserver scenarios make radio -o r",
    )
    making.add_argument(
        "name", metavar="NAME", help="as listed by 'hilserver scenarios list'"
    )
    add_out(making, "DIR", "folder")
    making.add_argument(
        "--seed", type=int, default=0, help="seed of the random sizes; default: 0"
    )
    making.set_defaults(action=_make)
    page = actions.add_parser(
        "page",
        help="diagnose them and write docs/explanation/scenarios.md with a plot of each",
        epilog="example: hilserver scenarios page -o docs/explanation",
    )
    page.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="only these; the others keep their sections",
    )
    add_out(page, "DIR", "folder")
    page.set_defaults(action=_page)


def run(args: argparse.Namespace) -> int:
    """List, make, or write the page."""
    args.action(args)
    return EXIT_DONE


def _list(args: argparse.Namespace) -> None:  # noqa: ARG001 (one shape)
    for entry in SCENARIOS.values():
        print(f"{entry.name:18} {entry.says}")


def _make(args: argparse.Namespace) -> None:
    drive = write(scenario(args.name), args.seed, args.out)
    logs = " ".join(str(args.out / LOGS / name) for name in drive.logs)
    if drive.against:
        others = " ".join(str(args.out / AGAINST / name) for name in drive.against)
        logs = f"--compare {logs} --against {others}"
    print(
        f"hilserver diagnose {logs} -c {args.out / CONFIG} -o {args.out / 'diagnosis'}"
    )
    print(f"the truth is sealed in {args.out / SEALED}")


def _page(args: argparse.Namespace) -> None:
    page = beside("reference.scenarios.page")
    if page is None:
        raise FailedError(
            "'scenarios page' writes a page of the source: run it in a checkout"
        )
    chosen = [scenario(name) for name in args.names] or list(SCENARIOS.values())
    k = 0
    with Progress(lambda: f"stopped after {k} of {len(chosen)} scenarios") as progress:
        for k, one in enumerate(chosen):
            progress(one.name, k / len(chosen))
            page.write_page(args.out, {one.name: page.make_entry(one)})
            progress.say(one.name, sys.stdout)
    print(f"The page is {args.out / page.PAGE}")
