"""From a record to a verdict: features, the ANN cascade, its training, the diagnosis.

One verb: `ema_prognostics.verdict.diagnose.diagnose(record) -> Verdict`. Needs no ROS.
"""
