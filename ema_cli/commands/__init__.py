"""The commands of `ema`: options in, one call, answer out."""
