"""The emulated actuator: plant, effects, kernel, acquisition.

`simulate.simulate` runs a test and returns a `Record`; `session.ActuatorSession` runs one
block by block, for a node.
"""
