"""What is hidden, how it is sealed and recorded, whether it can be seen. No workflow in here."""
