"""The robust cascade: features from the physics, networks, guard, baseline, verdict.

Every file has one part; `diagnosis.diagnose_robust` joins them.
"""
