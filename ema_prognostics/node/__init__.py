"""What the prognostics node does besides judging: assembling a record, filling messages."""
