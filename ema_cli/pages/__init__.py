"""Pages and files for others: the report of a test, the page of a fleet."""
