"""The client's other way to hear a skin: through zenoh, from another machine or container."""

import threading
import time
from typing import Any

from ohmskin.client.board import check_name
from ohmskin.client.felt import Felt
from ohmskin.errors import DataError, PublishError
from ohmskin.publish.messages import decode_contacts
from ohmskin.publish.topics import contacts_topic


class Far:
    """The newest contacts of a sender elsewhere; see `Client`. Its clock and ours should agree (NTP), for ages come from stamps.

    Raises:
        PublishError: If the extra `zenoh` is missing, or the name or the place cannot be used.
    """

    def __init__(self, name: str, where: str, token: str | None) -> None:
        try:
            from ohmskin.publish.zenoh import data_key, open_session
        except ImportError as error:
            raise PublishError("hearing a skin over zenoh needs a package: pip install 'ohmskin[zenoh]'") from error
        check_name(name)
        self._fresh: Felt | None = None
        self._here = threading.Condition()
        self._session = open_session(where, False, token)
        self._subscriber = self._session.declare_subscriber(data_key(contacts_topic(name)), self._take)

    def newest(self) -> Felt | None:
        return self.wait(0.0)

    def wait(self, timeout: float) -> Felt | None:
        with self._here:
            self._here.wait_for(lambda: self._fresh is not None, timeout)
            fresh, self._fresh = self._fresh, None
            return fresh

    def close(self) -> None:
        self._session.close()

    def _take(self, sample: Any) -> None:
        try:
            felt = decode_contacts(sample.payload.to_bytes(), time.monotonic() - time.time())
        except DataError:
            return  # not of ours, or damaged: the one before grows old, which is what its reader looks at
        with self._here:
            self._fresh = felt
            self._here.notify_all()
