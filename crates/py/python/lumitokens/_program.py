"""The `lumi` program, which is part of the extension module."""

import signal
import sys

from ._lumitokens import run_program


def main() -> int:
    """Runs `lumi` with this process's arguments."""
    # The program answers Ctrl-C by itself; Python's own handler would only note it until the program has ended.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return run_program(["lumi", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
