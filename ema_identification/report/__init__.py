"""The report of an identification: one page to decide from, its plots, JSON and model file."""
