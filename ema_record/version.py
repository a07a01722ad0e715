"""Version of this software, as it stands in records."""

VERSION = "0.1.0"
