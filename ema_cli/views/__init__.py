"""What the terminal and the plots show."""
