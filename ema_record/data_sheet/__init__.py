"""From a motor's data sheet to the description of an actuator, with the origin of each value."""
