"""What each test needs and how often it runs: the one place where markers are assigned.

A row names a file, or a test of it (`file::test`, as a glob), a marker, what the test cannot do without, and why. A
test whose needs are not there is skipped with the Debian package to install; in CI it fails.
"""

import ctypes
import os
import shutil
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import pytest


@dataclass(frozen=True)
class Need:
    """Something outside Python: a program, a shared library (`lib....so.N`) or a path; any of `names` will do."""

    names: tuple[str, ...]
    package: str

    def met(self) -> bool:
        """Whether one of them is there."""
        return any(_found(name) for name in self.names)


def _found(name: str) -> bool:
    if name.startswith("/"):
        return Path(name).exists()
    if ".so" not in name:
        return shutil.which(name) is not None
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


def needs(*names: str, package: str) -> None:
    """Skip the running test unless one of these is there, naming the Debian package to install; in CI fail."""
    if not Need(names, package).met():
        reason = f"needs {' or '.join(names)}: apt-get install {package}"
        if os.environ.get("CI"):
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason)


# The shell, without the window that a browser draws for itself even where nobody sees it, takes a third of its time.
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
CHROMIUM = Need(BROWSERS, "chromium")
QEMU = Need(("qemu-system-arm",), "qemu-system-arm")
ARM = Need(("arm-none-eabi-gcc",), "gcc-arm-none-eabi libnewlib-arm-none-eabi")
MAKE = Need(("make",), "make")
GCC = Need(("gcc",), "gcc libc6-dev")
CLANG = Need(("clang",), "clang")
FAST_DDS = Need(("/usr/include/fastdds",), "libfastrtps-dev")
GXX = Need(("g++",), "g++")
GL = Need(("libEGL.so.1", "libOSMesa.so.8"), "libegl1 libgl1")
FFMPEG = Need(("ffmpeg",), "ffmpeg")
GMSH = tuple(
    Need((library,), package)
    for library, package in (
        ("libGLU.so.1", "libglu1-mesa"),
        ("libXcursor.so.1", "libxcursor1"),
        ("libXinerama.so.1", "libxinerama1"),
        ("libXft.so.2", "libxft2"),
    )
)


@dataclass(frozen=True)
class Row:
    """Tests, the marker they carry, what they need, and why (asked for where the marker is `long`)."""

    tests: str
    marker: str
    needs: tuple[Need, ...] = ()
    reason: str = ""


# What takes long and is seldom broken alone; each line says what of the same feature runs every day.
LONG = {
    "test_auxiliary.py::test_each_of_three": "single contacts with the same channel",
    "test_bigger.py::test_presses_all_over*[[]42O": "the same in the tracking mode",
    "test_bigger.py::test_presses_all_over*[[]42P": "the same in the tracking mode",
    "test_body_page.py::test_the_benchmark": "the same page with skins of another body",
    "test_body_page.py::test_clicking_the_skin": "the same page with skins that only note how they are pressed",
    "test_calibrate.py::test_drift_is_told": "noise, and that a quiet skin does not drift",
    "test_calibrate.py::test_the_virtual_skin_calibrates_itself": "the same calibration runs in its parts",
    "test_channels.py::test_presses_without_labels*[[]4": "another seed",
    "test_channels.py::test_presses_without_labels*[[]5": "another seed",
    "test_cli.py::test_a_killed_live": "a live loop that ends by itself, and a recorder that is killed",
    "test_cli.py::test_a_lost_device": "a device that stalls in test_faults.py",
    "test_cli.py::test_headless_table_over": "serial lines in test_driver.py, what a loop prints in test_readme.py",
    "test_compiling.py::test_a_command_says_so": "that nothing is left to compile at the first touch",
    "test_compiling.py::test_a_loop_has_it": "that nothing is left to compile at the first touch",
    "test_compiling.py::test_nothing_is_left*[[]12B": "the same of `16P`, which compiles most",
    "test_compiling.py::test_nothing_is_left*[[]16T": "the same of `16P`, which compiles most",
    "test_compiling.py::test_nothing_is_left*[[]16O": "the same of `16P`, which compiles most",
    "test_compiling.py::test_nothing_is_left_to_compile_in": "what stands in for a mode, in test_sensors.py",
    "test_compiling.py::test_the_skin_is_felt_while": "what stands in for a mode, in test_sensors.py",
    "test_conformance.py::test_the_virtual_driver_passes": "a driver over the wire that passes the same checks",
    "test_conformance.py::test_the_wire_driver_passes*[[]True": "the same over TCP",
    "test_curved.py::test_a_press_on_a_curved*[[]dome-16O": "the same dome with `16T`, the same mode on a sleeve",
    "test_curved.py::test_a_press_on_a_curved*[[]dome-16P": "the same dome with `16T`, the same mode on a sleeve",
    "test_curved.py::test_a_press_on_a_curved*[[]sleeve-16T": "the same sleeve with `16P`, the same mode on a dome",
    "test_dataset.py::test_number_of_workers": "samples that are the same whenever and wherever they are made",
    "test_diagnosis.py::test_[itsv]*[[]16O": "the same in the modes that fit contacts",
    "test_diagnosis.py::test_a_frame_without_any*[[]*--3e+38": "values as large, and no number at all",
    "test_diagnosis.py::test_a_frame_without_any*[[]*-inf": "values as large, and no number at all",
    "test_diagnosis.py::test_what_is_the_same*[[]*hum of 5": "a hum of 1 mV, and an offset",
    "test_diagnosis.py::test_voltages_behind*[[]*--0.001": "no current, one far too large, and none at all",
    "test_diagnosis.py::test_voltages_behind*[[]*-inf": "no current, one far too large, and none at all",
    "test_diagnosis.py::test_an_electrode_that_opens*[[]*-0": "one on the rim and one inside",
    "test_diagnosis.py::test_an_electrode_that_opens*[[]*-7": "one on the rim and one inside",
    "test_documentation.py::test_a_newcomer": "that every command is understood, and each command in test_cli.py",
    "test_documentation.py::test_a_first_session": "that every command is understood, and each command in test_cli.py",
    "test_documentation.py::test_commands_of_guides": "that every command is understood, and each in its own tests",
    "test_documentation.py::test_commands_run": "that every command is understood, and each command in test_cli.py",
    "test_domains.py::test_rings_of_nodes": "what a contact impedance does in test_policies.py",
    "test_faults.py::test_a_host_that_was_suspended": "the loss of a device in other ways",
    "test_faults.py::test_a_serial_port_that_goes": "a cable pulled and plugged in again",
    "test_faults.py::test_one_byte_in_a_hundred": "spoilt lines in test_driver.py",
    "test_filter.py::test_another_contact_is_found*[[]40": "the same at less noise",
    "test_filter.py::test_single_pairs_may_drift": "a finger that warms what it rests on",
    "test_firmware.py::test_ten_seconds_of_fuzzing": "requests by hypothesis",
    "test_firmware_loop.py::test_a_late_sample": "a bad line in the same emulator",
    "test_firmware_loop.py::test_a_session_finds": "frames of the same board in the same emulator",
    "test_forces.py::test_forces_that_swell": "forces that change, and what is stated of them, in the same file",
    "test_forces.py::test_no_force_is_told*[[]12": "another seed",
    "test_forces.py::test_ten_known": "the same presses of one skin in test_presses.py",
    "test_foam.py::test_forces_are_followed": "forces that change in test_forces.py, and what foam adds in this file",
    "test_fuzzing.py::test_ten_seconds": "some mutations of each kind",
    "test_guides.py::test_a_drive_an_estimator": "modes of a skin's own, and what others register, in test_sensing.py",
    "test_guides.py::test_example_runs*[[]curved": "curved skins in test_curved.py, and the text of all",
    "test_guides.py::test_example_runs*[[]drive_design": "another example, and the text of all",
    "test_guides.py::test_example_runs*[[]estimators": "another example, and the text of all",
    "test_guides.py::test_example_runs*[[]forward": "another example, and the text of all",
    "test_guides.py::test_example_runs*[[]learning": "judgement and learning in test_channels.py and test_learn.py",
    "test_guides.py::test_example_runs*[[]meshes": "another example, and the text of all",
    "test_guides.py::test_example_runs*[[]priors": "another example, and the text of all",
    "test_guides.py::test_example_runs*[[]regularisation": "another example, and the text of all",
    "test_guides.py::test_example_runs*[[]tracking": "another example, and the text of all",
    "test_hostile.py::test_live_stands": "the loop against a dozen of the same faults",
    "test_import.py::test_the_example_of": "what these examples call",
    "test_independent.py::test_": "faults, quiet frames and presses of the virtual skin",
    "test_layout.py::test_a_better_layout": "the search itself",
    "test_layout.py::test_layouts_of_curved*[[]cone": "the same on a sleeve",
    "test_layout.py::test_layouts_of_curved*[[]triangle": "the same on a sleeve",
    "test_gestures.py::test_training_makes": "the model that ships tells the same simulated gestures",
    "test_learn.py::test_known_presses": "the same on one skin with fewer presses",
    "test_learn.py::test_a_skin_with_a_weaker": "a skin with other flaws and fewer presses",
    "test_learn.py::test_presses_in_a_robots": "the same presses in the skin's frame",
    "test_live_browser.py::test_a_finger": "presses on the same page",
    "test_meshed.py::test_a_press_on_a_skin_cut*[[]ring": "a patch, and a sleeve in test_curved.py",
    "test_meshed.py::test_electrodes_on_the_rim*[[]even": "the same of electrodes round the rim",
    "test_movement.py::test_it_is_that_of_the_sheet*[[]True": "the same of points, in half the time",
    "test_package.py::test_the_client_can_be": "that the client imports the standard library only",
    "test_package.py::test_the_readme_of_an_index": "links made absolute, in a text of one line",
    "test_package.py::test_wheel_and_sdist": "what is public, from the sources",
    "test_patches.py::test_a_robot_feels": "the body file, the merged stream and its page in one process",
    "test_policies.py::test_a_second_run": "the cache in test_reproduce.py",
    "test_policies.py::test_contact_impedances": "a change of all contact impedances in test_sensing.py",
    "test_policies.py::test_in_equal_time*[[]multiplexed": "the same of parallel converters",
    "test_policies.py::test_schemes_drive*[[]16O fused": "the same of other schemes",
    "test_policies.py::test_the_command_runs": "experiments in test_trouble.py",
    "test_policies.py::test_the_report_has": "experiments in test_trouble.py",
    "test_policies.py::test_two_close": "two presses apart, and one that is one, in test_several.py and test_filter.py",
    "test_recorder.py::test_at_most_50*[[]302": "the same killed at two other moments",
    "test_recorder.py::test_at_most_50*[[]353": "the same killed at two other moments",
    "test_recorder.py::test_killed_at_other": "the same killed at two other moments",
    "test_recorder.py::test_live_records_too": "the recorder and the command that is made for it",
    "test_recorder.py::test_the_guides_example": "the recorder it calls",
    "test_replay.py::test_pictures_and_films": "the replay, and pictures of single images",
    "test_reproduce.py::test_a_killed_run": "results kept and found again",
    "test_reproduce.py::test_a_quantity": "the experiments in test_evaluate_*.py",
    "test_reproduce.py::test_a_second_run": "results kept and found again",
    "test_reproduce.py::test_every_number": "the experiments in test_evaluate_*.py",
    "test_reproduce.py::test_pictures_are_large": "the experiments in test_evaluate_*.py",
    "test_reproduce.py::test_processes_and_a_dask": "results kept and found again",
    "test_reproduce.py::test_the_report_needs": "the experiments in test_evaluate_*.py",
    "test_reproduce.py::test_the_report_opens": "the experiments in test_evaluate_*.py",
    "test_ros_node.py::test_a_node": "the same topics read by DDS and zenoh, and joint states of a DDS writer",
    "test_holes.py::test_a_press_beside": "meshes with holes, and fits that keep out of them",
    "test_instrumented.py::test_known_presses": "the load cell, whose samples are fitted alike",
    "test_robot.py::test_a_robot_in_curved": "the arm that is poked, skins on links, and self-touch, each by itself",
    "test_robot.py::test_pads_press": "an arm that is poked by the same hands",
    "test_robot.py::test_command_line_draws": "the same command without pictures",
    "test_robot.py::test_same_seed_same_run": "the seeds of the virtual skin",
    "test_robot.py::test_skin_of_another_shape": "the paper's skin",
    "test_scale.py::test_with_many_electrodes": "the same with sixteen",
    "test_scale.py::test_a_start_is": "that the loop's commands start, and what they feel",
    "test_screens.py::test_states": "the states of the page in test_view_states.py",
    "test_segments.py::test_noise_makes": "noise of single frames in the same file",
    "test_self_test.py::test_the_command_says_so": "the self-test that the command calls",
    "test_sensing.py::test_a_change_of_all_contact*[[]0.9": "the change the other way",
    "test_shell_commands.py::test_a_command_runs": "that every command is run or listed",
    "test_shell_commands.py::test_what_pip": "that the extras are there",
    "test_several.py::test_two_presses_are_two*[[]0.025-9-16T": "the same farther apart",
    "test_sheet.py::test_a_recording_holds": "the fit before the loop starts, and skins in recordings",
    "test_sheet.py::test_a_skin_that_is_not": "electrodes and sheet found again",
    "test_sheet.py::test_contacts_are_placed": "electrodes and sheet found again",
    "test_sheet.py::test_electrodes_are_found*[[]pressed": "the same on discs, and the quiet virtual skin",
    "test_shipped_recordings.py::test_a_newcomers_recording*[[]False": "the same with a demonstration finger",
    "test_skin.py::test_a_press_does_what_finite*[[]light": "hard, small and overlapping ones",
    "test_terminal.py::test_ctrl_c": "Ctrl-C while a command is imported and while a loop calibrates",
    "test_terminal.py::test_a_sign_of_life": "that signs of life come in silence",
    "test_tracking_engine.py::test_the_guides_example": "the same tracking, frame by frame",
    "test_trouble.py::test_a_gain_is_told": "contacts read from the same set-up in test_policies.py",
    "test_trouble.py::test_pairs_that_drift": "drift of the whole skin, and of single contacts, in test_filter.py",
    "test_trouble.py::test_the_lightest_press": "contacts read from the same set-up in test_policies.py",
    "test_view_session.py::test_a_slow_estimator_says": "that one is told of once",
}

# What every version of Python and of what we depend on must pass (`make test-versions`): one test of each package that
# is used, and the shortest way through sensing, recording, pictures and exports.
SMOKE = (
    "test_cli.py::test_every_command_has_help*",
    "test_cli.py::test_headless_json*",
    "test_cli.py::test_help_and_suggestions*",
    "test_cli.py::test_image_shows*",
    "test_dataset.py::test_another_recipe*",
    "test_docstrings.py::test_every*",
    "test_domains.py::test_surfaces_come_back*",
    "test_domains.py::test_gmsh_refines*",
    "test_mcap.py::test_other_messages*",
    "test_model_files.py::test_meshes_fields*",
    "test_package.py::test_every*",
    "test_package.py::test_help_imports*",
    "test_priors.py::test_the_image_under*",
    "test_publish.py::test_contacts_are_read*",
    "test_publish.py::test_a_dds_endpoint*",
    "test_recorder.py::test_without_images*",
    "test_replay.py::test_parquet_takes*",
    "test_robot.py::test_place_and_force*",
    "test_view.py::test_frame_arrives*",
)

TABLE = (
    Row("test_view_browser.py", "browser", (CHROMIUM,)),
    Row("test_view_states.py", "browser", (CHROMIUM,)),
    Row("test_live_browser.py", "browser", (CHROMIUM,)),
    Row("test_guide.py", "browser", (CHROMIUM,)),
    Row("test_accessible.py", "browser", (CHROMIUM,)),
    Row("test_screens.py::test_states*", "browser", (CHROMIUM,)),
    Row("test_body_page.py::test_a_finger_on_the_page*", "browser", (CHROMIUM,)),
    Row("test_body_page.py::test_everyone*", "browser", (CHROMIUM,)),
    Row("test_body_page.py::test_maps_and_their*", "browser", (CHROMIUM,)),
    Row("test_report.py::test_sentences*", "browser", (CHROMIUM,)),
    Row("test_body_page.py::test_the_benchmark*", "browser", (CHROMIUM,)),
    Row("test_body_page.py::test_clicking_the_skin*", "browser", (CHROMIUM,)),
    Row("test_electrodes_page.py::test_clicks*", "browser", (CHROMIUM,)),
    Row("test_electrodes_page.py::test_everyone*", "browser", (CHROMIUM,)),
    Row("test_patches.py::test_the_gallery_opens_one*", "browser", (CHROMIUM,)),
    Row("test_patches.py::test_a_robot_feels_where_it_is_touched*", "browser", (CHROMIUM,)),
    Row("test_firmware.py::test_the_core_*", "compiler", (MAKE, GCC)),
    Row("test_firmware.py::test_ten_seconds_of_fuzzing*", "compiler", (MAKE, CLANG)),
    Row("test_firmware_loop.py::test_both_targets*", "compiler", (MAKE, ARM)),
    *(
        Row(f"test_firmware_loop.py::{name}*", "qemu", (MAKE, ARM, QEMU))
        for name in (
            "test_frames_are",
            "test_averages",
            "test_a_session",
            "test_a_reset",
            "test_a_late",
            "test_a_bad_line",
            "test_one_pattern",
            "test_a_press_off",
            "test_a_new_host",
            "test_an_emulator",
            "test_the_command_serves",
        )
    ),
    Row("test_publish_live.py::test_fast_dds_reads_it", "compiler", (FAST_DDS, GXX)),
    Row("test_cpp_client.py", "compiler", (GXX,)),
    Row("test_robot.py::test_command_line_draws*", "gl", (GL, FFMPEG)),
    Row("test_robot.py::test_mujoco_that_was_imported*", "gl", (GL,)),
    *(Row(f"test_domains.py::{name}", "gmsh", GMSH) for name in ("*gmsh*", "test_refined*", "test_a_broken*")),
    *(Row(f"{tests}*", "long", reason=reason) for tests, reason in LONG.items()),
    *(Row(tests, "smoke") for tests in SMOKE),
)


def rows(path: str, name: str) -> list[Row]:
    """The rows of the table that speak of a test: its file's name, and its own name with parameters."""
    return [row for row in _of_file(path) if path == row.tests or fnmatch(f"{path}::{name}", row.tests)]


@cache
def _of_file(path: str) -> list[Row]:
    return [row for row in TABLE if row.tests.partition("::")[0] == path]
