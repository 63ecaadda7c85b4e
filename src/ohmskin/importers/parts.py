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
        frames: Frames to look at, in order.
        skin: The shipped skin description that fits the format; empty if none fits.
        notes: What was left out or assumed on reading, in plain words.
        reader: All that a recording of ours holds beside; None for others.
        positions: (n_frames, 2) where each frame was pressed (m), in any frame; None: not known.
        forces: (n_frames,) with which force (N); None likewise.
        values: What the voltages are: ``voltages``; or ``magnitudes`` or ``differences``, of which `resolved` makes
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
