"""Signals of a rig record: even, filtered, gated; their band and clocks."""
