"""Features of a record: what each measures, and all of them in one vector."""
