"""Detection benchmark: a held-out fleet with its own generator, and what comes of it."""
