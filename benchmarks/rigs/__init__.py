"""Identification of rigs: two public data sets, and synthetic ones with a known answer."""
