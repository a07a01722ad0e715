"""Many actuators at a glance: bags judged once, units worst first, tables for other tools."""
