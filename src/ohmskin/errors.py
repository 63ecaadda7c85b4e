"""One tree of errors. Every message says what is wrong, the value, what is allowed and what to do next."""


class OhmskinError(Exception):
    """Base class of every error that ohmskin raises on purpose."""


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
    """What is felt cannot be published, or not be heard."""


class DeviceError(OhmskinError):
    """Anything that goes wrong between the host and the skin."""


class DeviceLost(DeviceError, ConnectionError):
    """The device does not answer or has gone; reconnecting may help."""


class DeviceRefused(DeviceError):
    """The device answered and said no."""


class ProtocolError(DeviceError, ValueError):
    """Bytes that are not a valid message of this protocol version."""
