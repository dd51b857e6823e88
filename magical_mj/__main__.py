"""`python -m magical_mj` is the command `magical-mj`."""

import sys

if __name__ == "__main__":
    try:
        from magical_mj.cli import main

        sys.exit(main())
    except KeyboardInterrupt:  # before `main` takes care of it
        sys.exit(130)
