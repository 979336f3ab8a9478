"""``python -m kbstore.cli.demo [FILE]``."""

import argparse
import sys
from pathlib import Path

from kbstore.cli.demo.tour import run
from kbstore.errors import KbStoreError


def main() -> int:
    """Run the demonstration, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m kbstore.cli.demo", description="A robot's morning, and questions.")
    parser.add_argument("file", nargs="?", type=Path, help="the SQLite file to create (default: a new one here)")
    try:
        run(parser.parse_args().file)
    except KbStoreError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
