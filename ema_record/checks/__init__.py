"""May this record be used? One engine, whatever the actuator's health.

A rule is a name, a remedy and a function from `facts.BagFacts` to what it found. A fault of the
actuator is no defect of its recording: every bound is one that no such actuator can pass. What
the rules find is shown in three ways: `run.lint_bag` tells all of it, `guard.guard_findings`
what forbids a verdict, `live.check_record` the record checks of the built-in test.
"""
