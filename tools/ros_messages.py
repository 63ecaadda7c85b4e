"""Write the messages of the ROS 2 package ros/ohmskin_msgs: those that ohmskin publishes and records."""

from pathlib import Path

from ohmskin.outlets.topics import TEXTS

FOLDER = Path(__file__).parents[1] / "ros" / "ohmskin_msgs" / "msg"


def messages() -> dict[str, str]:
    """The definition of each message of the package, by the name of its file."""
    own = {kind: text for kind, text in TEXTS.items() if kind.startswith("ohmskin_msgs/")}
    return {f"{kind.partition('/')[2]}.msg": text for kind, text in own.items()}


if __name__ == "__main__":
    for name, text in messages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
