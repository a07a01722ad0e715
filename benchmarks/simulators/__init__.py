"""Work against error: our kernel beside other simulators of motor drives."""
