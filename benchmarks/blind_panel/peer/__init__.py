"""The peer: plain sparse regression (pysindy's STLSQ) with the same library of laws."""
