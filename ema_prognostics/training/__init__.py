"""Training: simulated fleets, fits, calibration, error rates on fresh fleets."""
