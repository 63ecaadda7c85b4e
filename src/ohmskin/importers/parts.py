"""What a recording holds, whatever its format."""

from collections.abc import Sequence
from dataclasses import dataclass

from ohmskin.arrays import Floats
from ohmskin.mcap.reader import RecordingReader
from ohmskin.scan import Frame


@dataclass(frozen=True)
class Recording:
    """Contents of a recording.

    Args:
        quiet: Frames of the untouched skin.
        frames: The other frames, in order.
        skin: The shipped skin description that fits the format; empty if none fits.
        notes: What was left out or assumed on reading, in plain words.
        reader: Reader of all other contents of an ohmskin recording; None for others.
        positions: (n_frames, 2) place of the press of each frame (m), in any coordinate frame; None: not known.
        forces: (n_frames,) its force (N); None likewise.
        values: What the values are: ``voltages``; or ``magnitudes`` or ``differences``, which `resolved` converts to
            voltages.
    """

    quiet: Sequence[Frame]
    frames: Sequence[Frame]
    skin: str
    notes: tuple[str, ...] = ()
    reader: RecordingReader | None = None
    positions: Floats | None = None
    forces: Floats | None = None
    values: str = "voltages"
