"""What the nodes share: parameters, publishers, processes and their domain."""
