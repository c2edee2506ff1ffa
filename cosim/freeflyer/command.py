"""The entry point of `freeflyer`: it stands before the slow imports, so that an interrupt during them is an orderly end too."""

from __future__ import annotations

import signal
import sys

from freeflyer.errors import STOPPED


def main() -> int:
    """See freeflyer.cli.main. SIGTERM ends a command as Ctrl-C does."""
    try:
        signal.signal(signal.SIGTERM, _interrupt)
        from freeflyer.cli import main as command

        return command()
    except KeyboardInterrupt:
        print("freeflyer: interrupted; what was written until now is whole", file=sys.stderr)
        return STOPPED


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
