"""Lets ``python -m ema_cli`` be the `ema` command."""

from ema_cli.main import main

if __name__ == "__main__":
    main()
