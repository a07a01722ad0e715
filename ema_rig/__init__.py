"""Records of a test rig: what they hold, their bag, and the files that they are imported from."""
