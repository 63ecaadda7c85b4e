"""What must be closed once it is not needed any more: processes, files, connections."""

from abc import ABC, abstractmethod
from typing import Self


class Closing(ABC):
    """A context manager that closes itself at the end."""

    @abstractmethod
    def close(self) -> object:
        """Let go of what it holds, and say how that went if there is anything to say. Safe twice."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
