"""Names of modules, classes, functions and arguments: the field's terms, none for two things, no private words."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src" / "ohmskin"

PRIVATE = {  # what nobody else calls so, with what the field does
    "beside": "marginalised, next to, auxiliary",
    "born": "birth",
    "believed": "prior",
    "desk": "the sensor, the engine",
    "door": "server, guard",
    "echo": "kept_signal",
    "explainer": "ContactFitter",
    "falls": "bipolar",
    "far": "remote",
    "felt": "contacts, detected",
    "film": "video",
    "foreseen": "predicted",
    "glance": "residuals",
    "hear": "subscribe, receive",
    "held": "fixed, state",
    "informed": "TrackingDrive",
    "kitchen": "process",
    "lab": "setup",
    "likeness": "similarity",
    "manner": "strategy",
    "misfit": "QuadraticMisfit, GoodnessOfFit, image_misfit",
    "reading": "observation",
    "sag": "source_loading",
    "said": "likelihood, signal",
    "scored": "scores, with_scores",
    "see": "update, add, simulate",
    "shelf": "cache",
    "sight": "percept",
    "sighting": "PatchState",
    "tape": "RecordingReader",
    "tell": "report, notify, classify",
    "teller": "reporter",
    "told": "reported, nominal, estimates",
    "trick": "ProtocolFault",
    "warmth": "common_drift",
    "wary": "inflated",
    "wearer": "RobotSimulation",
}
ALLOWED = {
    ("mcap/writer.py", "tell"),  # Python's name of it for files
    ("contacts/misfit.py", "misfit"),  # of least squares, as in geophysics
    ("scan/network.py", "misfit"),
    ("sensing/readers.py", "misfit"),
    ("sensing/confidence.py", "misfit"),
    ("evaluate/policies/schemes.py", "reading"),  # a key of a scheme in stored studies
}
TWICE = {  # of classes that never meet: one is of the package behind another, or both are one thing
    "Settings": "each study's own, which its command makes of options",
    "Target": "a contact as an input of a drive; the known target of a figure of merit",
    "Press": "a press on the skin; the alias of the same for a finger on the page",
}


def names() -> Iterator[tuple[str, str, str]]:
    """Kind, file and name of all that is named in the sources."""
    for path in sorted(SOURCE.rglob("*.py")):
        where = str(path.relative_to(SOURCE))
        yield "module", where, path.stem
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                yield "class", where, node.name
            elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield "function", where, node.name
            elif isinstance(node, ast.arg):
                yield "argument", where, node.arg


def test_nothing_has_a_private_name() -> None:
    found = [
        f"{where}: {kind} {name!r}; say {PRIVATE[name.lower().strip('_')]}"
        for kind, where, name in names()
        if name.lower().strip("_") in PRIVATE and (where, name) not in ALLOWED
    ]
    assert not found, "\n".join(found)


def test_no_two_classes_have_one_name() -> None:
    homes = defaultdict(list)
    for kind, where, name in names():
        if kind == "class" and not name.startswith("_"):
            homes[name].append(where)
    twice = {name: where for name, where in homes.items() if len(where) > 1 and name not in TWICE}
    assert not twice, twice
