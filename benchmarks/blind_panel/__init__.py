"""Blind panel of the model-gap workflow: sealed truth, runs that see bags only, a table."""
