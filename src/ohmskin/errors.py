"""One tree of errors. Every message says what is wrong, the value, what is allowed and what to do next."""

import re


class OhmskinError(Exception):
    """Base class of every error that ohmskin raises on purpose.

        OhmskinError
            GeometryError         a ValueError, too
            PatternError          a ValueError, too
            ModelError            a ValueError, too
            SkinError             a ValueError, too
            DataError             a ValueError, too
            ViewError
            PublishError
            DeviceError
                DeviceLost        a ConnectionError, too
                DeviceRefused
                ProtocolError     a ValueError, too

    Control characters in messages are escaped and long words shortened, because they may come from a device or a file.
    """

    def __init__(self, *args: object) -> None:
        super().__init__(*(harmless(part) if isinstance(part, str) else part for part in args))


def harmless(text: str) -> str:
    """A text fit for a terminal: control and reordering characters written out, long words shortened."""
    text = re.sub(r"\S{501,}", lambda word: f"{word[0][:60]}... ({len(word[0])} characters)", text)
    return re.sub(
        r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", lambda character: repr(character[0])[1:-1], text
    )


def shown(value: object) -> str:
    """A value from outside as a message shows it: written out as far as it is short."""
    try:
        text = repr(value)
    except ValueError:  # Python writes out no number of more than 4,300 digits
        return "a number of thousands of digits"
    return text if len(text) <= 100 else f"{text[:60]}... ({len(text)} characters)"


class GeometryError(OhmskinError, ValueError):
    """A mesh, domain or electrode layout that cannot be used."""


class PatternError(OhmskinError, ValueError):
    """A drive pattern that is malformed or does not fit the electrodes."""


class ModelError(OhmskinError, ValueError):
    """A forward or inverse problem that is not well posed."""


class SkinError(OhmskinError, ValueError):
    """A skin description that is incomplete or out of range."""


class DataError(OhmskinError, ValueError):
    """A recording or frame that cannot be read."""


class ViewError(OhmskinError):
    """The live page cannot be served or was given something it cannot show."""


class PublishError(OhmskinError):
    """Contacts that cannot be published or received, or a command that a skin refuses."""


class DeviceError(OhmskinError):
    """Anything that goes wrong between the host and the skin."""


class DeviceLost(DeviceError, ConnectionError):
    """The device does not answer or has gone; reconnecting may help."""


class DeviceRefused(DeviceError):
    """The device answered, and refused the request."""


class ProtocolError(DeviceError, ValueError):
    """Bytes that are not a valid message of this protocol version."""


LINK_ERRORS = DeviceLost, DeviceRefused, ProtocolError
"""What a new connection may mend."""
