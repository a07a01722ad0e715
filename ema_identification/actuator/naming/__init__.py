"""From a residual to a name: proposals, fits with the simulator, decision, estimates."""
