"""From a record to a verdict: features, the ANN cascade, its training, the diagnosis.

One verb: `ema_prognostics.diagnosis.diagnose(record) -> Verdict`. Needs no ROS.
"""
