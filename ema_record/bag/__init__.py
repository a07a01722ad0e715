"""The rosbag2 directory: read, written, recovered, exported."""
