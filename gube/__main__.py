"""``python -m gube``: the command ``gube``."""

import sys

from runtime.cli.command import main

if __name__ == "__main__":
    sys.exit(main())
