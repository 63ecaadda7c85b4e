"""The named modes: which drive, reader, estimator and prior go together, with a plain name and a sentence each."""

from dataclasses import replace

from ohmskin.drive.patterns import is_local
from ohmskin.errors import PatternError
from ohmskin.skin import Mode, Skin

MODES = (
    Mode(
        "{rim}B",
        drive="rim",
        reader="centroid",
        title="Rim of {rim}",
        summary="Adjacent drive on the {rim} electrodes of the rim; contacts are centroids of the image.",
    ),
    Mode(
        "{all}I",
        drive="rings",
        reader="centroid",
        title="Rim and inside",
        summary="Adjacent drive on the rim and on the inner ring; contacts are centroids of the image.",
    ),
    Mode(
        "{all}O",
        drive="eq7",
        reader="centroid",
        title="Adaptive, as in the paper",
        summary="A base scan of the rim, then the pairs closest to the contacts; contacts are centroids of the image.",
    ),
    Mode(
        "{all}P",
        drive="position",
        reader="fit",
        driven=True,
        title="Adaptive, most precise",
        summary="A base scan, then the pairs most informative about positions; contacts are fitted to the data.",
    ),
    Mode(
        "{all}T",
        drive="tracking",
        reader="tracked",
        driven=True,
        title="Tracking, fastest",
        summary="A few injections a frame where most informative; contacts are tracked on the data.",
    ),
)
"""The modes that ship; ``{rim}`` and ``{all}`` are replaced by numbers of electrodes."""

LEARNED = Mode(
    "{all}L",
    drive="rim",
    reader="learned",
    title="Learned",
    summary="Adjacent drive on the rim; one contact is placed by the learned map, several are fitted to the data.",
)
"""Of skins that have learned from presses (`ohmskin learn`)."""

RECORDED = Mode(
    "recorded",
    drive="recorded",
    reader="consensus",
    title="As recorded",
    summary="The recording's pattern; contacts are those on which the image and a fit to the data agree.",
)
"""The mode of recordings with a pattern of their own."""

DEFAULT = "{all}P"
"""The mode with the smallest measured error, of those without tracking (docs/modes.md)."""


def modes(skin: Skin) -> dict[str, Mode]:
    """The modes of a skin by name: those that ship and its electrodes allow, then those of its own file."""
    own = {mode.name: mode for mode in skin.modes}
    none = {"rings"} if len(skin.electrodes.rings) == 1 else {"rim", "rings"} if is_local(skin.electrodes) else set()
    learned = (LEARNED,) if skin.calibration.position_map else ()
    shipped = [_named(mode, skin) for mode in MODES + learned if mode.drive not in none]
    if is_local(skin.electrodes):  # the raster does not grow with the skin, nor do images' modes
        shipped = [mode.using(prior="pixels") for mode in shipped]
    return {**{mode.name: mode for mode in shipped if mode.name not in own}, **own}


def default_mode(skin: Skin) -> str:
    """The name of the mode that the loop of a `skin` starts in unless one is given."""
    return _filled(DEFAULT, skin)


def recorded_mode(skin: Skin) -> Mode:
    """The mode for recordings of a `skin` with their own pattern: contacts by the learned map, if it has one."""
    return replace(RECORDED, reader="learned") if skin.calibration.position_map else RECORDED


def mode_named(skin: Skin, name: str) -> Mode:
    """The mode of that name; the default one if it is empty.

    Raises:
        PatternError: If the skin has no such mode; the message lists its modes.
    """
    found = modes(skin)
    if (name or default_mode(skin)) not in found:
        raise PatternError(f"mode {name!r} is not possible with this skin; choose from {', '.join(found)}")
    return found[name or default_mode(skin)]


def _named(mode: Mode, skin: Skin) -> Mode:
    name, title, summary = (_filled(text, skin) for text in (mode.name, mode.title, mode.summary))
    return replace(mode, name=name, title=title, summary=summary, fuse=skin.imaging.fuse)


def _filled(text: str, skin: Skin) -> str:
    return text.format(rim=len(skin.electrodes.rings[0]), all=len(skin.electrodes))
