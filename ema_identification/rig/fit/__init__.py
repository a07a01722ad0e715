"""Fitting laws to a rig: balance, regression, null by sign flips, estimates."""
