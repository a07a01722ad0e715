"""What is shown of a rig's answer."""
