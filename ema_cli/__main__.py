"""Where `ema` begins, installed or as ``python -m ema_cli``."""

import signal
import sys

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def main() -> None:
    """Run `ema` and exit; Ctrl-C while its modules are loaded is one line, status 130."""
    try:  # with those of the command: `with_common` hears what has come, once all is there
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        from ema_cli.main import main as run
    except KeyboardInterrupt:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        sys.stderr.write("ema: interrupted\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
