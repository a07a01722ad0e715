"""From a record to a name: healthy fleet, likelihood, proposals, decision."""
