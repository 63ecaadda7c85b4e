"""What a skin is: its description there and back, and its physics against a system assembled in one piece."""

import math
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.sparse import block_array, csc_array, diags_array, kron
from scipy.sparse.linalg import splu

from ohmskin.errors import ModelError, PatternError, SkinError
from ohmskin.geometry import Disc
from ohmskin.scan import DrivePattern, FrameFlag, adjacent
from ohmskin.sensing import default_mode, modes
from ohmskin.skin import Press, PressedSheet, Skin, VirtualSkin, shipped_skins
from ohmskin.skin.description import ContactLayer, Imaging, Sheet
from ohmskin.skin.instrument import Converter, Excitation
from ohmskin.skin.layout import ElectrodeLayout

PAPER = Skin()
COARSE = replace(PAPER, imaging=replace(PAPER.imaging, mesh_size=0.012))
DISC = replace(
    COARSE,
    sheet=Sheet(shape="disc", radius=0.08),
    electrode=ElectrodeLayout(layout="rim", count=8, radius=5e-3),
    contact_layer=ContactLayer(columns=10, rows=8, patch=11e-3, foam_spread=0.0),
)
QUIET = Converter(noise=0.0, bits=32, full_scale=100.0, time_constant=0.0)
BASE = adjacent([range(12)])


@cache
def coarse() -> PressedSheet:
    return PressedSheet(COARSE)


def four_terminal(r: np.ndarray, pattern: DrivePattern) -> np.ndarray:
    a, b, c, d = pattern.quadruples.T
    return r[a, c] - r[a, d] - r[b, c] + r[b, d]


def pair_resistance(r: np.ndarray) -> np.ndarray:
    return np.diag(r)[:, None] + np.diag(r)[None] - r - r.T


# --- description ------------------------------------------------------------------------------------------------------


def value_of(entry: Any) -> st.SearchStrategy[Any]:
    kind = type(entry.default)
    if kind is bool:
        return st.booleans()
    if kind is str:
        return st.sampled_from(entry.metadata.get("choices", [""]))
    if kind is tuple:
        return st.just(())
    low, high = entry.metadata["low"], entry.metadata["high"]
    return st.integers(math.ceil(low), math.floor(high)) if kind is int else st.floats(low, high)


def any_table(kind: type, **limits: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.builds(kind, **{entry.name: value_of(entry) for entry in fields(kind)} | limits)


skins = st.builds(
    Skin,
    name=st.text(),
    sheet=any_table(Sheet).map(lambda sheet: replace(sheet, shape="rectangle")),
    electrode=any_table(ElectrodeLayout, inset=st.floats(0, 4e-4)).filter(
        lambda electrode: electrode.layout != "listed"
    ),
    contact_layer=any_table(ContactLayer),
    excitation=any_table(Excitation),
    converter=any_table(Converter),
    imaging=any_table(Imaging),
)


@given(skins)
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])  # others on the machine slow it down
def test_what_is_written_is_read_back(skin: Skin) -> None:
    assert Skin.parse(skin.dump()) == skin


def test_nothing_given_is_the_sensor_of_the_paper() -> None:
    assert Skin.parse("") == PAPER == Skin.load("paper")
    assert (PAPER.sheet.width, PAPER.sheet.height, PAPER.sheet.conductivity) == (0.2, 0.2, 1.83e-3)
    patches = PAPER.contact_layer.patches(PAPER.chart)
    middles, sides = patches.middles, patches.sides
    assert middles.shape == (24 * 24, 2)
    assert sides == pytest.approx(np.full((24 * 24, 2), 7.5e-3))


@pytest.mark.parametrize("name", shipped_skins())
def test_shipped_skins_load_and_can_be_imaged(name: str) -> None:
    skin = Skin.load(name)
    assert skin.name == name
    rim = len(skin.electrodes.rings[0])
    names = list(modes(skin))
    assert names[0] == f"{rim}B"
    assert f"{len(skin.electrodes)}O" in names
    assert default_mode(skin) in names
    mesh = skin.mesh()
    assert len(mesh.nodes_at(skin.electrodes.positions)) == len(skin.electrodes)
    assert mesh.measures.sum() == pytest.approx(skin.domain.area, rel=5e-3)


def test_the_skins_of_the_paper_have_its_modes() -> None:
    assert list(modes(Skin.load("paper"))) == ["12B", "16I", "16O", "16P", "16T"]
    assert list(modes(Skin.load("paper-rim16"))) == ["16B", "16O", "16P", "16T"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "sheets = 1",
            "unknown entry 'sheets'; choose from name, sheet, electrode, contact_layer, excitation, converter",
        ),
        (
            "[sheet]\nwidht = 0.2",
            "unknown entry sheet.widht; choose from shape, width, height, radius, top_radius, angle, outline, profile,",
        ),
        ("sheet = 3", "sheet is 3; it must be a table \\[sheet\\]"),
        ("name = 3", "name is 3; it must be text"),
        ('[sheet]\nshape = "oval"', "sheet.shape is 'oval'; choose from rectangle, disc"),
        ("[sheet]\nshape = 1", "sheet.shape is 1; it must be text"),
        ('[sheet]\nwidth = "0.2"', "sheet.width is '0.2'; it must be a number"),
        ("[sheet]\nwidth = true", "sheet.width is True; it must be a number"),
        ("[sheet]\nwidth = 0", "sheet.width is 0; it must be 0.001 to 10 m"),
        ("[sheet]\nwidth = 11", "sheet.width is 11; it must be 0.001 to 10 m"),
        ("[sheet]\nwidth = nan", "sheet.width is nan; it must be"),
        ("[sheet]\nconductivity = inf", "sheet.conductivity is inf; it must be 1e-09 to 1e\\+06 S per square"),
        ("[sheet]\nwidth = 1" + 400 * "0", "sheet.width is 10.*; it must be 0.001 to 10 m"),
        ("[sheet]\nwidth = 1" + 5000 * "0", "not valid TOML: Exceeds the limit"),
        ("[electrode]\ncolumns = 4.0", "electrode.columns is 4.0; it must be a whole number"),
        ("[electrode]\ncolumns = 1", "electrode.columns is 1; it must be 2 to 32"),
        ("[electrode]\ninset = 0.2", "electrode: grid inset 0.2 m; it must be from 0 to below half of the sheet's"),
        ("[imaging]\nfuse = 1", "imaging.fuse is 1; it must be true or false"),
        ('[sheet]\nshape = "disc"', 'electrode.layout is "grid", which needs a rectangle or a sleeve; use "rim"'),
        ("[sheet", "not valid TOML"),
    ],
)
def test_an_error_says_what_is_wrong_and_what_is_allowed(text: str, message: str) -> None:
    with pytest.raises(SkinError, match=f"^here: .*{message}|^here is {message}"):
        Skin.parse(text, "here")


def test_a_skin_made_in_code_is_checked_like_one_read() -> None:
    with pytest.raises(SkinError, match=r"sheet.width is -1; it must be 0.001 to 10 m"):
        Skin(sheet=Sheet(width=-1))


def test_skins_are_found_by_name_or_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.toml").write_text('name = "mine"\n[sheet]\nwidth = 0.3\n')
    assert Skin.load(tmp_path / "mine.toml").sheet.width == 0.3
    (tmp_path / "tank").mkdir()  # a folder of that name must not hide the shipped skin
    monkeypatch.chdir(tmp_path)
    assert Skin.load("tank").sheet.shape == "disc"
    with pytest.raises(
        SkinError, match=r"no skin named 'tnak'; give a .toml file or one of dome, ktc2023, paper, paper-rim16, sleeve"
    ):
        Skin.load("tnak")
    with pytest.raises(
        SkinError,
        match=r"cannot read skin file .*absent.toml.*shipped skins are dome, ktc2023, paper, paper-rim16, sleeve",
    ):
        Skin.load("absent.toml")
    (tmp_path / "empty.toml").write_text(" \n")
    with pytest.raises(SkinError, match=r"skin file empty\.toml is empty"):
        Skin.load("empty.toml")
    (tmp_path / "marked.toml").write_text('name = "mine"\n', encoding="utf-8-sig")
    assert Skin.load("marked.toml").name == "mine"
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SkinError, match="cannot read skin file"):
        Skin.load("binary.toml")


# --- the pressed sheet ------------------------------------------------------------------------------------------------


SMALL = replace(
    PAPER,
    sheet=replace(PAPER.sheet, width=0.04, height=0.04),
    electrode=replace(
        PAPER.electrode,
        layout="listed",
        radius=2e-3,
        positions=tuple(
            (1e-3 * x, 1e-3 * y) for x, y in ((10, 0), (40, 14), (26, 40), (0, 26), (8, 8), (31, 31), (20, 9))
        ),
    ),
    contact_layer=replace(PAPER.contact_layer, columns=5, rows=5),
)
PRESSES = {
    "none": [],
    "light": [Press((0.0205, 0.0185), 0.008, 2e3)],
    "hard": [Press((0.0205, 0.0185), 0.008, 60e3)],
    "small": [Press((0.0163, 0.0249), 0.003, 20e3)],
    "in a corner": [Press((0.001, 0.039), 0.008, 30e3)],
    "on an electrode": [Press((0.02, 0.009), 0.005, 20e3)],
    "several, overlapping": [
        Press((0.012, 0.012), 0.008, 3e3),
        Press((0.02, 0.012), 0.006, 30e3),
        Press((-0.003, 0.03), 0.01, 1e4),
    ],
}


@cache
def finely(name: str, step: float) -> np.ndarray:
    """Transfer resistances of `SMALL` from five-point differences, of patches and electrodes pressed on their nodes.

    Each electrode and patch is a conductor of one potential, joined to every node it covers by what its conductance per
    area makes of the node's share of the sheet.
    """
    layer, (width, height) = SMALL.contact_layer, (SMALL.sheet.width, SMALL.sheet.height)
    n, n_elec = round(width / step) + 1, len(SMALL.electrodes)
    x, y = (points.ravel() for points in np.meshgrid(step * np.arange(n), step * np.arange(n)))
    line = diags_array([-np.ones(n - 1), -np.ones(n - 1)], offsets=[-1, 1], shape=(n, n)).tolil()
    line.setdiag([1.0, *[2.0] * (n - 2), 1.0])
    inner = np.ones(n)
    inner[[0, -1]] = 0.5  # of a row of nodes on the rim, half a row of the sheet
    sheet = SMALL.sheet.conductivity * (kron(diags_array(inner), line) + kron(line, diags_array(inner)))
    area = step**2 * np.outer(inner, inner).ravel()
    joints = []
    for centre in SMALL.electrodes.positions:
        on = np.hypot(x - centre[0], y - centre[1]) < SMALL.electrode.radius
        whole = (
            0.5 if min(*centre, width - centre[0], height - centre[1]) < 1e-9 else 1.0
        )  # half of it is off the sheet
        share = on * area / (on * area).sum() * whole * np.pi * SMALL.electrode.radius**2
        joints.append(share / SMALL.electrode.contact_resistivity)
    pressure = np.zeros(len(x))
    for press in PRESSES[name]:
        beyond = np.hypot(x - press.position[0], y - press.position[1]) - press.radius
        pressure += press.pressure * np.clip(1 - beyond / layer.foam_spread, 0, 1)
    per_area = layer.conductance * (pressure / layer.pressure_scale) ** layer.exponent * area
    for j in range(layer.rows):
        for i in range(layer.columns):
            off = np.maximum(abs(x - (i + 0.5) * width / layer.columns), abs(y - (j + 0.5) * height / layer.rows))
            covered = np.clip((layer.patch / 2 - off) / step + 0.5, 0, 1)  # nodes on a patch's edge by half
            if (joint := per_area * covered).any():
                joints.append(joint)
    joined = csc_array(np.array(joints))
    system = block_array(
        [[sheet + diags_array(joined.sum(axis=0)), -joined.T], [-joined, diags_array(joined.sum(axis=1))]]
    )
    kept = np.delete(np.arange(system.shape[0]), len(x) + n_elec - 1)
    driven = np.zeros((len(kept), n_elec - 1))
    driven[len(x) + np.arange(n_elec - 1), np.arange(n_elec - 1)] = 1.0
    resistance = np.zeros((n_elec, n_elec))
    factor = splu(
        system.tocsc()[kept][:, kept], "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    resistance[:-1, :-1] = factor.solve(driven)[len(x) : len(x) + n_elec - 1]
    return resistance


@cache
def exactly(name: str) -> np.ndarray:
    """The same for ever smaller steps (Richardson; the error is of first order, where current enters at edges)."""
    return 2 * finely(name, 1.25e-4) - finely(name, 2.5e-4)


@pytest.mark.parametrize("name", [name for name in PRESSES if name != "none"])
def test_a_press_does_what_finite_differences_say_whatever_the_mesh(name: str) -> None:
    expected = exactly(name) - exactly("none")
    for size in (3e-3, 5.5e-3):
        sheet = PressedSheet(replace(SMALL, imaging=replace(SMALL.imaging, mesh_size=size)))
        assert np.abs(sheet.untouched - exactly("none")).max() < 0.01 * exactly("none").max()
        error = np.linalg.norm(sheet.transfer_resistance(PRESSES[name]) - sheet.untouched - expected)
        # a press smaller than a patch has its edge in the middle of few contacts
        assert error < (0.07 if name == "small" else 0.035) * np.linalg.norm(expected)


def test_transfer_resistances_are_symmetric_against_the_last_electrode() -> None:
    for presses in PRESSES.values():
        r = coarse().transfer_resistance(presses)
        assert np.abs(r - r.T).max() < 1e-12 * r.max()
        assert (r[-1] == 0).all()
        assert np.linalg.eigvalsh(r[:-1, :-1])[0] > 0


def test_pressing_more_never_raises_a_resistance() -> None:
    """Rayleigh: conductance added anywhere lowers the dissipation of every current."""
    before = coarse().untouched
    for pressure in (1e2, 1e3, 1e4, 1e5, 1e6, 1e7):
        after = coarse().transfer_resistance([Press((0.11, 0.06), 0.015, pressure)])
        assert np.linalg.eigvalsh(before - after)[0] > -1e-10 * before.max()
        before = after


def test_the_signal_grows_with_pressure_and_saturates_at_a_short_circuit() -> None:
    change = [
        np.linalg.norm(coarse().transfer_resistance([Press((0.09, 0.12), 0.01, 10.0**power)]) - coarse().untouched)
        for power in range(8)
    ]
    assert (np.diff(change) > 0).all()
    exponent = np.log10(np.array(change[1:]) / change[:-1])
    assert exponent[0] == pytest.approx(COARSE.contact_layer.exponent, abs=0.01)  # weak: as the contact conductance
    assert (np.diff(exponent)[:-1] < 0).all()
    assert exponent[-1] < 0.2  # more and more of the foam's soft edge joins in


def test_presses_are_a_set_and_pressures_add_up() -> None:
    a, b = PRESSES["several, overlapping"][:2]
    r = coarse().transfer_resistance
    np.testing.assert_array_equal(r([a, b]), r([b, a]))
    np.testing.assert_allclose(r([a, a]), r([replace(a, pressure=2 * a.pressure)]), rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(r([replace(a, pressure=0.0)]), coarse().untouched)
    np.testing.assert_array_equal(r(iter([])), coarse().untouched)


def test_mirrored_presses_give_mirrored_signals() -> None:
    """The sheet and its patches have a mirror, its mesh has not: the difference is the error of the mesh."""
    positions = COARSE.electrodes.positions
    mirrored = [int(np.argmin(np.linalg.norm(positions - [0.2 - x, y], axis=1))) for x, y in positions]
    change = [coarse().transfer_resistance([Press((x, 0.13), 0.012, 20e3)]) - coarse().untouched for x in (0.06, 0.14)]
    change = [pair_resistance(c) for c in change]
    assert np.linalg.norm(change[1][np.ix_(mirrored, mirrored)] - change[0]) < 0.04 * np.linalg.norm(change[0])


def test_bad_contact_is_the_resistance_of_the_electrode_area_on_the_sheet() -> None:
    """Contact resistances rule: R_pair = rho (1 / A_i + 1 / A_j), with quarter discs in corners and half discs on the
    rim."""
    rho, radius = 100.0, 3e-3
    r = pair_resistance(
        PressedSheet(replace(COARSE, electrode=ElectrodeLayout(radius=radius, contact_resistivity=rho))).untouched
    )
    share = np.array([1 / 4, 1 / 2, 1 / 2] * 4 + [1.0] * 4)
    contact = rho / (share * np.pi * radius**2)
    expected = contact[:, None] + contact[None] - 2 * np.diag(contact)
    np.testing.assert_allclose(r, expected, rtol=0.01)


@cache
def paper_sheet() -> PressedSheet:
    return PressedSheet(PAPER)


def test_a_firm_press_on_the_paper_skin_changes_the_largest_voltage_by_some_per_cent() -> None:
    """Contact conductance of twice the sheet's per square millimetre: a signal of about 7 % (findings, section 2)."""
    quiet = four_terminal(paper_sheet().untouched, BASE)
    signal = [
        np.abs(four_terminal(paper_sheet().transfer_resistance([Press(at, 8e-3, 20e3)]), BASE) - quiet).max()
        / np.abs(quiet).max()
        for at in ((0.03, 0.1), (0.035, 0.165), (0.1, 0.03))
    ]
    assert min(signal) > 0.01
    assert max(signal) < 0.2


def test_the_mesh_matters_little_to_measured_voltages_and_some_to_driven_ones() -> None:
    """Area electrodes keep driven voltages finite, but elements are wider than electrodes here."""
    fine, middle = pair_resistance(paper_sheet().untouched), pair_resistance(coarse().untouched)
    off = ~np.eye(16, dtype=bool)
    assert np.abs(middle / np.where(off, fine, 1) - 1)[off].max() < 0.14
    four = [four_terminal(sheet.untouched, BASE) for sheet in (paper_sheet(), coarse())]
    assert np.linalg.norm(four[1] - four[0]) < 0.05 * np.linalg.norm(four[0])


@pytest.mark.parametrize(
    ("position", "radius", "pressure", "message"),
    [
        ((np.nan, 0), 0.01, 1.0, "not finite"),
        ((0, 0), 0.01, np.inf, "not finite"),
        ((0, 0), 0.0, 1.0, "radius is 0.0 m; it must be above 0"),
        ((0, 0), 1.1, 1.0, "radius is 1.1 m"),
        ((0, 0), 0.01, -1.0, "pressure is -1.0 Pa; it must be 0 to 10 MPa"),
        ((0, 0), 0.01, 2e7, "pressure is"),
    ],
)
def test_impossible_presses_are_refused(
    position: tuple[float, float], radius: float, pressure: float, message: str
) -> None:
    with pytest.raises(SkinError, match=message):
        Press(position, radius, pressure)


# --- the virtual skin -------------------------------------------------------------------------------------------------


def virtual(seed: int = 0, converter: Converter = QUIET, excitation: Excitation = PAPER.excitation) -> VirtualSkin:
    """A virtual skin whose sheet is the coarse one; the instrument differs, not the sheet."""
    skin = replace(COARSE, converter=converter, excitation=excitation)
    return VirtualSkin(skin, seed=seed)


def test_a_voltage_source_drives_what_the_pair_and_all_that_is_in_series_let_through() -> None:
    skin = virtual(excitation=Excitation(amplitude=5.0, resistance=50.0, multiplexer_resistance=100.0))
    pattern = adjacent(COARSE.electrodes.rings)
    for press in (False, True):
        if press:
            skin.press(1, 0.05, 0.05, 0.02, 1e5)
        r = coarse().transfer_resistance(skin.presses.values())
        pair = pair_resistance(r)[tuple(pattern.injections.T)]
        frame = skin.scan(pattern)
        current = 5.0 / (pair + 50 + 2 * 100 + 100)
        np.testing.assert_allclose(frame.currents, current, rtol=1e-6)
        np.testing.assert_allclose(
            frame.voltages, four_terminal(r, pattern) * current[pattern.measurements[:, 0]], atol=1e-7
        )
        assert frame.flags == FrameFlag(0)


def test_a_current_source_drives_its_amplitude() -> None:
    frame = virtual(excitation=Excitation(source="current", amplitude=1.5e-3)).scan(BASE)
    np.testing.assert_allclose(frame.currents, 1.5e-3, rtol=1e-6)
    np.testing.assert_allclose(frame.voltages, 1.5e-3 * four_terminal(coarse().untouched, BASE), atol=1e-7)


def test_the_current_limit_holds_and_is_flagged() -> None:
    free = virtual().scan(BASE).currents
    limit = float(np.median(free))
    frame = virtual(excitation=Excitation(current_limit=limit)).scan(BASE)
    np.testing.assert_allclose(frame.currents, np.minimum(free, limit), rtol=1e-6)
    assert frame.flags == FrameFlag.CURRENT_LIMIT


@pytest.mark.parametrize(("noise", "bits"), [(1e-3, 24), (0.2e-3, 16), (0.5e-3, 13)])
def test_the_scatter_of_voltages_is_the_noise_and_the_converter_step(noise: float, bits: int) -> None:
    skin = virtual(converter=Converter(noise=noise, bits=bits))
    volts = np.array([skin.scan(BASE).voltages for _ in range(200)])[1:]
    step = 10.0 / 2**bits
    scatter = np.sqrt(np.mean(volts.var(axis=0, ddof=1)))
    assert scatter == pytest.approx(np.hypot(noise, step / np.sqrt(12)), rel=4 / np.sqrt(2 * 108 * 198))


def test_voltages_come_in_steps_of_the_converter() -> None:
    step = 10.0 / 2**8
    frame = virtual(converter=Converter(noise=0.0, bits=8, time_constant=0.0)).scan(BASE)
    exact = virtual().scan(BASE)
    np.testing.assert_allclose(frame.voltages / step, np.round(frame.voltages / step), atol=1e-9)
    assert np.abs(frame.voltages - exact.voltages).max() <= step / 2 + 1e-6
    assert np.abs(frame.voltages - exact.voltages).max() > step / 4
    np.testing.assert_allclose(frame.currents * 100 / step, np.round(frame.currents * 100 / step), atol=1e-9)


def test_beyond_full_scale_voltages_are_infinite_with_their_sign_and_flagged() -> None:
    both_ways = DrivePattern(BASE.injections, np.vstack([BASE.measurements, BASE.measurements[:, [0, 2, 1]]])[
        np.argsort(np.tile(BASE.measurements[:, 0], 2), kind="stable")])  # fmt: skip
    exact = virtual(converter=replace(QUIET, shunt=1e-3)).scan(both_ways).voltages
    full_scale = 0.3 * float(np.abs(exact).max())
    frame = virtual(converter=replace(QUIET, full_scale=full_scale, shunt=1e-3)).scan(both_ways)
    over = np.abs(exact) > full_scale * (1 + 1e-6)
    np.testing.assert_array_equal(frame.voltages[over], np.copysign(np.inf, exact[over]))
    assert np.isfinite(frame.voltages[~over & (np.abs(exact) < full_scale * (1 - 1e-6))]).all()
    assert frame.flags == FrameFlag.CLIPPED


def test_a_shunt_voltage_beyond_full_scale_is_flagged_though_all_others_are_in_range() -> None:
    frame = virtual(converter=replace(QUIET, full_scale=1.0, shunt=3e3)).scan(BASE)
    assert np.isfinite(frame.voltages).all()
    assert np.isinf(frame.currents).all()
    assert frame.flags == FrameFlag.CLIPPED


@pytest.mark.parametrize(("settle", "constant"), [(20e-6, 12e-6), (150e-6, 12e-6), (0.0, 1e-6)])
def test_channels_start_from_what_the_injection_before_left(settle: float, constant: float) -> None:
    skin = virtual(converter=replace(QUIET, settle=settle, time_constant=constant))
    currents = virtual().scan(BASE).currents
    r = coarse().untouched
    left, channels = math.exp(-settle / constant), np.zeros(16)
    for _ in range(2):
        expected = []
        for k, (source, sink) in enumerate(BASE.injections):
            settled = currents[k] * (r[source] - r[sink])
            channels = settled + left * (channels - settled)
            rows = BASE.measurements[BASE.measurements[:, 0] == k]
            expected += [channels[plus] - channels[minus] for _, plus, minus in rows]
        np.testing.assert_allclose(skin.scan(BASE).voltages, expected, atol=1e-6)


def test_the_clock_and_the_count_go_with_the_injections() -> None:
    skin = virtual(converter=Converter(settle=1e-3, conversion=2e-4))
    assert skin.duration(BASE) == pytest.approx(12 * 1.2e-3)
    frames = [skin.scan(BASE) for _ in range(3)]
    assert [frame.time for frame in frames] == pytest.approx([12 * 1.2e-3 * k for k in (1, 2, 3)])
    assert [frame.sequence for frame in frames] == [1, 2, 3]
    assert frames[0].pattern is BASE


def test_the_same_seed_repeats_every_frame() -> None:
    def run(seed: int) -> np.ndarray:
        skin = virtual(seed, Converter())
        first = skin.scan(BASE)
        skin.press(1, 0.1, 0.1, 0.01, 1e4)
        second = skin.scan(BASE)
        return np.concatenate([first.voltages, first.currents, second.voltages, second.currents])

    np.testing.assert_array_equal(run(3), run(3))
    assert (run(3) != run(4)).mean() > 0.5


def test_a_press_can_be_moved_and_lifted() -> None:
    skin = virtual()
    quiet = skin.scan(BASE).voltages
    skin.press(7, 0.05, 0.05, 0.01, 2e4)
    skin.press(7, 0.15, 0.05, 0.01, 2e4)
    skin.press(8, 0.1, 0.15, 0.01, 2e4)
    assert list(skin.presses) == [7, 8]
    assert skin.presses[7].position == (0.15, 0.05)
    assert np.abs(skin.scan(BASE).voltages - quiet).max() > 1e-3
    skin.presses.clear()  # a copy
    for number in (7, 8, 99):
        skin.press(number, -1.0, 0.0, 0.01, 0.0)
    assert skin.presses == {}
    np.testing.assert_array_equal(skin.scan(BASE).voltages, quiet)


def test_a_press_off_the_sheet_is_refused_and_changes_nothing() -> None:
    skin = VirtualSkin(DISC, seed=0)
    for x, y in ((0.081, 0.0), (0.06, 0.06), (-0.2, 0.0)):
        assert Disc(0.08).depth([[x, y]])[0] < 0
        with pytest.raises(SkinError, match="is off the sheet; its bounds are"):
            skin.press(1, x, y, 0.01, 1e4)
    with pytest.raises(SkinError, match="pressure is -5"):
        skin.press(1, 0.0, 0.0, 0.01, -5.0)
    assert skin.presses == {}
    skin.press(1, 0.056, 0.056, 0.01, 1e4)
    assert len(skin.presses) == 1


def test_a_press_on_the_rim_is_not_refused_for_rounding() -> None:
    """Devices are told places in single precision."""
    skin = VirtualSkin(Skin.load("paper"), seed=0)
    x, y = (float(np.float32(0.2)) for _ in range(2))
    assert x > 0.2
    skin.press(1, x, y, 0.006, 1e4)
    assert len(skin.presses) == 1


def test_presses_that_would_take_minutes_to_model_are_refused_and_change_nothing() -> None:
    skin = VirtualSkin(Skin.load("paper"), seed=0)
    skin.press(1, 0.1, 0.1, 8e-3, 2e4)
    before, resistance = skin.presses, skin.transfer_resistance
    with pytest.raises(SkinError, match=r"20\d+ contacts .* take about \d+ s to model; allowed are 5000") as told:
        skin.press(2, 0.1, 0.1, 1.0, 2e4)
    assert len(str(told.value)) <= 120  # as long as the protocol's refusals may be
    assert skin.presses == before
    assert skin.transfer_resistance is resistance
    skin.press(1, 0.1, 0.1, 8e-3, 0.0)


def test_many_lifts_cost_one_model_and_only_when_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    skin, modelled = virtual(), []
    quiet = skin.scan(BASE).voltages
    for number in range(4):
        skin.press(number, 0.05, 0.04 * (1 + number), 8e-3, 2e4)
    kept, under = skin.scan(BASE).voltages, PressedSheet.transfer_resistance
    monkeypatch.setattr(
        PressedSheet, "transfer_resistance", lambda self, presses: modelled.append(1) or under(self, presses)
    )
    for number in (1, 2, 3, 3):
        skin.press(number, 0.0, 0.0, 8e-3, 0.0)
    assert modelled == []
    left = [skin.scan(BASE).voltages for _ in range(2)]
    assert modelled == [1]
    np.testing.assert_array_equal(*left)
    assert np.abs(left[0] - kept).max() > 1e-3
    assert np.abs(left[0] - quiet).max() > 1e-3


def test_foam_that_spreads_a_press_over_all_patches_makes_presses_costly_and_no_skin() -> None:
    paper = Skin.load("paper")
    skin = VirtualSkin(replace(paper, contact_layer=replace(paper.contact_layer, foam_spread=0.95)), seed=0)
    assert np.count_nonzero(skin.sheet._patches.update._known) < 1000
    with pytest.raises(SkinError, match=r"contacts of patches take about .* allowed are 5000"):
        skin.press(1, 0.1, 0.1, 8e-3, 2e4)


def test_a_press_that_is_told_again_costs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    skin = VirtualSkin(Skin.load("paper"), seed=0)
    skin.press(1, 0.1, 0.1, 8e-3, 2e4)
    monkeypatch.setattr(PressedSheet, "transfer_resistance", lambda *_: pytest.fail("it was modelled again"))
    skin.press(1, 0.1, 0.1, 8e-3, 2e4)
    skin.press(2, 0.1, 0.1, 8e-3, 0.0)  # lifts what is not there


def test_a_press_that_the_mesh_cannot_carry_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    skin = VirtualSkin(Skin.load("paper"), seed=0)

    def fail(*_: object) -> None:
        raise ModelError("too coarse")

    with monkeypatch.context() as patch:
        patch.setattr(PressedSheet, "transfer_resistance", fail)
        with pytest.raises(ModelError, match="too coarse"):
            skin.press(1, 0.1, 0.1, 8e-3, 1e7)
    assert skin.presses == {}
    skin.press(1, 0.1, 0.1, 8e-3, 2e4)


def test_a_pattern_for_more_electrodes_is_refused() -> None:
    with pytest.raises(PatternError, match="names electrode 15; there are 8"):
        VirtualSkin(DISC, seed=0).scan(adjacent([range(16)]))


def test_a_current_source_stops_at_its_limit_and_says_so() -> None:
    skin = Skin.parse('[excitation]\nsource = "current"\namplitude = 1.0\ncurrent_limit = 0.02\n')
    frame = VirtualSkin(skin, 0).scan(adjacent([skin.electrodes.rings[0]]))
    assert FrameFlag.CURRENT_LIMIT in frame.flags
    assert frame.currents.max() < 0.021


def test_a_press_on_a_prepared_patch_computes_no_near_field(monkeypatch: pytest.MonkeyPatch) -> None:
    sheet = PressedSheet(Skin.load("paper"), contacts=4)
    sheet.prepare()  # the first patch, in the corner

    def refused(*_: object) -> None:
        raise AssertionError("computed anew")

    monkeypatch.setattr("ohmskin.forward.near_field.log_means", refused)
    assert (sheet.transfer_resistance([Press((4e-3, 4e-3), 1e-3, 1e4)]) != sheet.untouched).any()
    with pytest.raises(AssertionError, match="computed anew"):
        sheet.transfer_resistance([Press((0.05, 0.15), 1e-3, 1e4)])
