"""The command line, in this process: the same entry point as `python -m ohmskin`, without the seconds of a new
interpreter."""

import io
import os
import re
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from subprocess import CompletedProcess
from unittest.mock import patch

from ohmskin.cli import main


def ohmskin(*arguments: str, cwd: Path | None = None) -> "CompletedProcess[str]":
    """What `ohmskin` says to these arguments; an error that a user would see as a traceback is raised."""
    out, err, status = io.StringIO(), io.StringIO(), 0
    with (
        chdir(cwd or "."),
        patch.object(sys, "argv", ["ohmskin", *arguments]),
        patch.dict(os.environ, {"COLUMNS": "80"}),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 0
    said = re.sub(
        "^[.]+\n", "", err.getvalue(), flags=re.MULTILINE
    )  # signs of life, which depend on how busy the machine is
    return CompletedProcess(list(arguments), status, out.getvalue(), said)
