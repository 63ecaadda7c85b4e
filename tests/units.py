"""How tests are shared out: file by file, as fixtures are, the longest first; what is long and shares none, alone."""

from fnmatch import fnmatch
from functools import cache
from typing import Any

from xdist.scheduler import LoadScopeScheduling

# Files, and tests of them that set up nothing which others take too (`file::test`, as a glob): each of these is shared
# out by itself. Files that wait (for browsers, boards, lost devices) stand apart, the slowest of the others first.
SLOWEST = (
    "test_terminal.py",
    "test_compiling.py",
    "test_view_browser.py",
    "test_documentation.py",
    "test_independent.py",
    "test_policies.py",
    "test_guides.py",
    "test_independent.py::test_a_finger_that_rests*",
    "test_independent.py::test_a_contact_that_degrades*",
    "test_policies.py::test_two_close*",
    "test_reproduce.py",
    "test_foam.py",
    "test_diagnosis.py",
    "test_shell_commands.py",
    "test_learn.py",
    "test_trouble.py",
    "test_independent.py::test_a_sheet_that_drifts*",
    "test_cli.py",
    "test_lifted.py",
    "test_sensing.py",
    "test_meshed.py",
    "test_curved.py",
    "test_filter.py",
    "test_accessible.py",
    "test_skin.py",
    "test_replay.py",
    "test_recorder.py",
    "test_import.py",
    "test_publish_live.py",
    "test_layout.py",
    "test_robot.py",
    "test_forces.py",
    "test_holes.py",
    "test_view_states.py",
    "test_engine.py",
    "test_estimators.py",
    "test_shipped_recordings.py",
    "test_several.py",
    "test_sheet.py",
    "test_view_session.py",
    "test_domains.py",
    "test_dataset.py",
    "test_evaluate_two_points.py",
    "test_view_transport.py",
    "test_auxiliary.py",
    "test_self_test.py",
    "test_package.py",
    "test_evaluate_worlds.py",
    "test_calibrate.py",
    "test_fuzzing.py",
    "test_guide.py",
    "test_bigger.py",
    "test_cpp_client.py",
    "test_contact_layer.py",
    "test_channels.py",
    "test_hostile.py",
    "test_firmware_loop.py",
    "test_live_browser.py",
    "test_body_page.py",
    "test_faults.py",
    "test_electrodes_page.py",
)


@cache
def unit(path: str, name: str) -> tuple[int, str]:
    """What a test is shared out with, its file or itself, and where that comes among the others."""
    for place, row in enumerate(SLOWEST):
        if "::" in row and fnmatch(f"{path}::{name}", row):
            return place, f"{path}::{name}"
    return SLOWEST.index(path) if path in SLOWEST else len(SLOWEST), path


class Units(LoadScopeScheduling):
    """Gives a worker its next unit no sooner than it needs one: another worker may come to it first."""

    def _split_scope(self, nodeid: str) -> str:
        path, _, name = nodeid.partition("::")
        return unit(path.rpartition("/")[2], name)[1]

    def _reschedule(self, node: Any) -> None:
        # A worker runs a test once it knows the next one.
        if not self.workqueue or self._pending_of(self.assigned_work[node]) < 2:
            super()._reschedule(node)
