"""What a mode is: which drive, reader and estimator go together, by their names."""

from dataclasses import dataclass, fields, replace
from typing import Any

from ohmskin.errors import SkinError
from ohmskin.skin.checks import check_names, check_table, number


@dataclass(frozen=True)
class Mode:
    """One way to use a skin. Names are those of the tables `DRIVES`, `READERS`, `ESTIMATORS` and `PRIORS`.

    Args:
        name: Its label, such as ``16O``.
        drive: Drive, which chooses the measurements.
        reader: Reader, which estimates contacts.
        estimator: Estimator of the image.
        prior: Prior of the estimator.
        rule: How the regularisation parameter is chosen.
        injections: Per frame, of drives that take any number; 0: as many as the drive usually has.
        fuse: Whether all scans of a frame are used together, or only the last one.
        driven: Whether electrodes that carry the current are measured, too, by devices that can.
        title: Its plain name.
        summary: What it does, in one sentence.

    Raises:
        SkinError: If an entry is of the wrong type or out of range.
    """

    name: str
    drive: str
    reader: str
    estimator: str = "gauss-newton"
    prior: str = "paper"
    rule: str = "physical"
    injections: int = number(0, 0, 10**6)
    fuse: bool = True
    driven: bool = False
    title: str = ""
    summary: str = ""

    def __post_init__(self) -> None:
        check_table(f"modes.{self.name}", self)

    @property
    def entries(self) -> dict[str, Any]:
        """Its entries in a skin file or a recording: all but the name and defaults."""
        told = {entry: getattr(self, entry.name) for entry in fields(self) if entry.name != "name"}
        return {entry.name: value for entry, value in told.items() if value != entry.default}

    @property
    def label(self) -> str:
        """Its plain name, with its code in parentheses unless the name contains it."""
        if not self.title or self.name in self.title:
            return self.title or self.name
        return f"{self.title} ({self.name})"

    def using(self, estimator: str = "", prior: str = "", rule: str = "") -> "Mode":
        """The mode with another estimator, prior or rule; empty ones stay unchanged."""
        return replace(self, estimator=estimator or self.estimator, prior=prior or self.prior, rule=rule or self.rule)

    @classmethod
    def of(cls, name: str, entries: Any) -> "Mode":
        """The mode called `name` that a skin file or a recording describes, `entries` by their names.

        Raises:
            SkinError: If an entry is unknown, missing or of the wrong type.
        """
        names = [entry.name for entry in fields(cls) if entry.name != "name"]
        if not isinstance(entries, dict):
            raise SkinError(f"modes.{name} is {entries!r}; it must be a table [modes.{name}]")
        check_names(entries, names, f"modes.{name}.")
        if missing := [entry for entry in ("drive", "reader") if entry not in entries]:
            raise SkinError(f'modes.{name} does not say its {missing[0]}; add {missing[0]} = "..."')
        return cls(name, **entries)


def modes_of(tables: Any) -> tuple[Mode, ...]:
    """The modes of the tables ``[modes.NAME]`` of a skin file.

    Raises:
        SkinError: If one is not a valid mode.
    """
    if not isinstance(tables, dict):
        raise SkinError(f"modes is {tables!r}; it must be tables [modes.NAME]")
    return tuple(Mode.of(name, entries) for name, entries in tables.items())
