"""The `ema` command: thin, calls the other packages."""
