"""The robust cascade: inputs, networks, guard, and the model file that holds them."""
