"""Oracles, makers of defects and disturbed chains, for tests and benchmarks."""
