"""The decision of `ema identify` in its own world and outside, on declared panels."""
