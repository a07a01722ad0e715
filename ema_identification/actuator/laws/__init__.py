"""The catalogue as candidates: variants, what they add to a test, terms of a fit."""
