"""Version of the software, as it stands in package.xml and setup.py (a test compares)."""

VERSION = "0.1.0"
