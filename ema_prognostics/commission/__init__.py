"""Commissioning: from a description and records of healthy units to a kit."""
