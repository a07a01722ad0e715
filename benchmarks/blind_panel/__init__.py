"""Blind panel of `ema identify`: units drawn and sealed, runs that see bags only, tables."""
