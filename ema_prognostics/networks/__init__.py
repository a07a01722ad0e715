"""Small feed-forward networks and how they are fitted."""
