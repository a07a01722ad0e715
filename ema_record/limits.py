"""Bounds of everything that is read from a file, checked before memory is taken for it."""

from __future__ import annotations

MAX_MESSAGE_BYTES = 16 << 20
"""Largest message of `/ema/samples` (bytes)."""
MAX_SMALL_MESSAGE_BYTES = 1 << 20
"""Largest message of any other topic that is decoded (bytes)."""
MAX_RECORD_BYTES = 1 << 20
"""Largest schema, channel, header or metadata record of an MCAP file (bytes)."""
MAX_CHUNK_BYTES = 64 << 20
"""Largest chunk of an MCAP file, as stored and uncompressed (bytes)."""
MAX_TOTAL_BYTES = 8 << 30
"""Largest sum of the uncompressed chunks of a bag (bytes)."""
MAX_UNPACKED_FILE_BYTES = 1 << 30
"""Largest MCAP file that is itself compressed (``.mcap.zstd``), unpacked (bytes)."""
MAX_CHANNELS = 4096
"""Most channels, and most schemas, of one MCAP file."""
MAX_FILES = 1000
"""Most MCAP files of one bag."""
MAX_RATE = 1_000_000.0
"""Highest rate of a record (1/s)."""
MAX_DURATION = 60.0
"""Longest record (s)."""
MAX_POSITION = 10.0
"""Largest position of any surface (rad); each actuator refuses what is beyond its end stops."""
MAX_SAMPLES = int(MAX_RATE * MAX_DURATION)
"""Most samples of a record."""
MAX_MESSAGES = 1_000_000
"""Most messages of one topic."""
MAX_TEXT = 200
"""Most characters of a serial number or another name in a record."""
