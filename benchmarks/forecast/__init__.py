"""The forecast of `ema trend`, measured beside others: see `__main__`."""
