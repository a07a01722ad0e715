"""From a record to a name: likelihood, fits, proposals, evidence, intervals."""
