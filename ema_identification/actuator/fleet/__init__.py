"""Healthy units of a type: how they differ, what their records look like, what is kept of them."""
