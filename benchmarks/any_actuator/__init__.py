"""Any actuator: machines, a second simulator, and the kit judged on both."""
