"""``ohmskin`` and ``python -m ohmskin``: from here on, Ctrl-C ends it without a traceback, while it imports, too."""

import os
import signal

signal.signal(signal.SIGINT, lambda *_: os._exit(130))  # until a command begins, which may have to clean up

from ohmskin.cli import main  # noqa: E402

if __name__ == "__main__":
    main()
