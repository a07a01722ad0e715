"""Libraries: the fleet of one test built, judged and kept; what acceptance records add to it."""
