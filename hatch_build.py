"""What a package index shows: README.md with links that lead somewhere from there, and the project's addresses.

`repository` in pyproject.toml says where the sources are, such as https://example.org/ohmskin. Until it is known, links
to files become plain text and pictures are left out, because an index has neither.
"""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(!?)\[((?:[^][]|\[[^][]*\])*)\]\((?!https?://|#)([^)\s]+)\)")


def readme(text: str, repository: str) -> str:
    """The text of README.md for an index."""

    def replaced(found: re.Match[str]) -> str:
        picture, words, path = found.groups()
        if repository:
            return f"{picture}[{words}]({repository}/{'raw' if picture else 'blob'}/main/{path})"
        return "" if picture else words

    return _LINK.sub(replaced, text)


class CustomMetadataHook(MetadataHookInterface):
    """Fills in `readme` and `urls`."""

    def update(self, metadata: dict[str, Any]) -> None:
        repository = self.config["repository"].rstrip("/")
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": readme(text, repository)}
        if repository:
            pages = {"Documentation": "blob/main/README.md", "Changelog": "blob/main/CHANGELOG.md", "Issues": "issues"}
            metadata["urls"] = {
                "Repository": repository,
                **{name: f"{repository}/{page}" for name, page in pages.items()},
            }
