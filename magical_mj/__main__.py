"""`python -m magical_mj` is the command `magical-mj`."""

import sys

if __name__ == "__main__":
    try:
        from magical_mj.cli import main

        sys.exit(main())
    except KeyboardInterrupt:  # during the import; later, `main` handles it
        sys.exit(130)
