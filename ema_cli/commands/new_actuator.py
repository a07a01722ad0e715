"""x."""
def new_actuator() -> int:
    """Do x.

    Example: `ema new-actuator`
    """
    return 0
