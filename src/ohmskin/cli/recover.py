"""``ohmskin recover``: a complete copy of a truncated recording."""

from pathlib import Path

from ohmskin.mcap import recover as recover_file


def recover(file: Path, output: Path | None = None) -> None:
    """Repair a truncated recording: write an indexed copy of all readable parts. The original is kept.

    Args:
        file: The recording.
        output: The copy; NAME.recovered.mcap beside it unless given. An existing file is never overwritten.
    """
    done = recover_file(file, output)
    if done.whole and not done.damaged:
        print(f"{file} is intact; {done.path} is a copy of it")
    else:
        print(f"{file}: {done.lost} bytes at its end and {done.damaged} parts within it cannot be read")
    print(f"recovered {done.frames} frames ({done.messages} messages) to {done.path}")
