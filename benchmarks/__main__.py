"""``python -m benchmarks NAME`` does the same as ``hilserver bench NAME`` in a checkout."""

import sys

from hilserver.commands import main

sys.exit(main(["bench", *sys.argv[1:]]))
