"""``python -m hilserver`` is the command ``hilserver``."""

import sys

from hilserver.commands import main

if __name__ == "__main__":
    sys.exit(main())
