"""The decision in one likelihood: healthy fleet, compression, ranks, evidence of each law."""
