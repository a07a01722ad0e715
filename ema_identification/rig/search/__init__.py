"""The search for missing laws."""
