"""Test profiles made for an actuator: what its drive can do, the design, the plan of analysis."""
