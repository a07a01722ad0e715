"""What the simulator node does, without ROS."""
