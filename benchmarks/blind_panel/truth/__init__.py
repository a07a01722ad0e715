"""The truth program: draws what is hidden, seals it, makes the bags. No workflow in here."""
