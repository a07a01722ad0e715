"""Campaigns: many runs from a plan, stored resumably and reduced to tables."""
