"""The blind campaign from the shell."""

import argparse
from pathlib import Path

from tests.diagnosis.blind import campaign
from tests.diagnosis.blind.drawing import MAKERS


def words(text):
    """Words of a list with commas."""
    return tuple(filter(None, text.split(",")))


parser = argparse.ArgumentParser(
    prog="python -m tests.diagnosis.blind",
    description=campaign.__doc__,
    formatter_class=argparse.RawDescriptionHelpFormatter,
)
parser.add_argument(
    "--results", type=Path, required=True, help="one line of JSON per answer"
)
parser.add_argument(
    "--rounds", type=int, default=1, metavar="N", help="default %(default)s"
)
parser.add_argument(
    "--first", type=int, default=0, metavar="N", help="first round; default 0"
)
parser.add_argument("--classes", type=words, default=campaign.CLASSES, metavar="A,B")
parser.add_argument("--makers", type=words, default=MAKERS, metavar="A,B")
args = parser.parse_args()
answers = campaign.run(args.results, args.rounds, args.makers, args.classes, args.first)
print(campaign.table(answers))
