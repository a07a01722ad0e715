"""Verdicts over flights: announcement, evidence, growth and forecast."""
