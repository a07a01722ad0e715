"""The built-in test: interlock, sequence, record checks and the recorder of bags.

Imports `ema_record` and `ema_ros` only; the emulated actuator and a real one look the same from
here.
"""
