"""Where `ema` begins, installed or as ``python -m ema_cli``."""

import sys


def main() -> None:
    """Run `ema` and exit; Ctrl-C while its modules are loaded is one line, status 130."""
    try:
        from ema_cli.main import main as run
    except KeyboardInterrupt:
        sys.stderr.write("ema: interrupted\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
