"""`python -m magical_mj` is the command `magical-mj`."""

import sys

from magical_mj.cli import main

if __name__ == "__main__":
    sys.exit(main())
