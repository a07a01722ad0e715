"""From a record to a verdict: diagnosis, comparison with a baseline, reasons in words."""
