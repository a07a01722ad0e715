"""What was measured: records of a built-in test, and the bags that hold them.

`Record` is the only data type that crosses packages. Needs no ROS at run time.
"""
