"""How well the connection to a device works."""

from dataclasses import dataclass


@dataclass
class Link:
    """Counters since the connection was made."""

    requests: int = 0
    retries: int = 0  # requests sent again
    dropped: int = 0  # replies that nobody waited for: duplicates and late ones
    damaged: int = 0  # packets that failed framing or checksum
    resets: int = 0  # times the device had forgotten its patterns
    bytes_in: int = 0
    bytes_out: int = 0
