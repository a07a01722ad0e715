"""Peers of `ema identify` on the same records: STLSQ, ADCD and LISDD."""
