"""Where data come from: two models of a touched sheet, neither on the estimator's mesh.

- ``discs``: the paper's simulation. Discs of raised conductivity, point electrodes. The conductivity of each triangle
  is the exact mean over it. The mesh has edges half as long as the estimator's.
- ``pressed``: the contact-layer twin (`ohmskin.skin.PressedSheet`). Floating patches pressed on the sheet, area
  electrodes with contact impedance. The paper's physical experiments have this mechanism.

Both give transfer resistances under any contacts, for the electrode layouts ``grid`` (the paper's 12 rim and 4 inner
electrodes) and ``rim`` (16 on the rim). Data are voltages at one current, `CURRENT`, with white noise of one standard
deviation for all methods: so many decibels below the largest voltage that the 12-electrode adjacent scan (12B) has on
the untouched sheet of the same world. The untouched reference is taken as free of noise (in practice a mean of many
frames).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import OhmskinError
from ohmskin.evaluate.shapes import Shape, disc
from ohmskin.forward import TransferModel
from ohmskin.geometry import Mesh, mesh_domain
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.scan import DrivePattern, adjacent
from ohmskin.skin import PressedSheet, Skin
from ohmskin.skin.twin import Load

CURRENT = 1e-3  # amperes, in every injection
LAYOUTS = {"grid": "paper", "rim": "paper-rim16"}  # electrode layouts and the skins that have them
WORLD_NAMES = {"discs": "discs of raised conductivity", "pressed": "contact-layer twin"}
WORLDS = tuple(WORLD_NAMES)
CONTACT_STRENGTH = {"discs": 0.5, "pressed": 20e3}  # relative change of conductivity | pascals
CONTACT_ERROR = {"discs": 0.004, "pressed": 0.07}  # most that a disc gets wrong of a contact's signal
CONTACT_RADIUS = {"discs": 10e-3, "pressed": 8e-3}  # metres

Contacts = tuple[Shape, ...]


@dataclass(frozen=True)
class SimulatedSheet:
    """One touched sheet with one electrode layout.

    Args:
        mesh: That of its model.
        untouched: Transfer resistances (n_elec, n_elec) in ohms without contacts.
        touched: Those under contacts.
    """

    mesh: Mesh
    untouched: Floats
    touched: Callable[[Contacts], Floats]


def _discs(skin: Skin, finer: float = 0.48) -> SimulatedSheet:
    """Discs of raised conductivity on a sheet with point electrodes; where discs overlap their changes add up."""
    mesh = mesh_domain(skin.domain, finer * skin.imaging.mesh_size, skin.electrodes.positions)

    def touched(contacts: Contacts) -> Floats:
        change = np.zeros(mesh.n_elem)
        for contact in contacts:
            if contact.kind != "disc":
                raise OhmskinError(f"the world of discs has no {contact.kind}; press it on the world 'pressed'")
            share = disc_overlap(mesh, contact.position, contact.radius).toarray()[0]
            change += contact.strength * share / mesh.measures
        return TransferModel(mesh, skin.electrodes, skin.sheet.conductivity * (1 + change)).transfer_resistance

    return SimulatedSheet(mesh, touched(()), touched)


def _pressed(skin: Skin) -> SimulatedSheet:
    """Contacts pressed on the contact-layer twin; the foam spreads their edges, and pressures add up."""
    twin, spread = PressedSheet(skin), max(skin.contact_layer.foam_spread, 1e-12)

    def load(contact: Shape) -> Load:
        def pressure_at(points: Floats) -> Floats:
            away = contact.distance(points.reshape(-1, 2)).reshape(points.shape[:-1])
            return np.asarray(contact.strength * np.clip(1 - away / spread, 0.0, 1.0))

        return contact.position, np.sqrt(2) * contact.radius + spread, pressure_at

    def touched(contacts: Contacts) -> Floats:
        return twin.under(load(contact) for contact in contacts)

    return SimulatedSheet(twin.mesh, twin.untouched, touched)


def skin_of(world: str, layout: str) -> Skin:
    """What a description of the skin of a world says."""
    skin = Skin.load(LAYOUTS[layout])
    return replace(skin, imaging=replace(skin.imaging, contact_error=CONTACT_ERROR[world]))


@lru_cache(maxsize=8)
def sheet(world: str, layout: str, wear: float = 1.0, same_mesh: bool = False) -> SimulatedSheet:
    """The sheet of a world with an electrode layout; made once per process.

    Args:
        world: One of `WORLDS`.
        layout: One of `LAYOUTS`.
        wear: Contact impedance of the electrodes over the usual one; point electrodes (discs) have none.
        same_mesh: Whether discs are on the estimator's mesh.

    Raises:
        OhmskinError: If there is no such world.
    """
    if world not in WORLDS:
        raise OhmskinError(f"no world {world!r}; choose from {', '.join(WORLDS)}")
    skin = Skin.load(LAYOUTS[layout])
    electrode = replace(skin.electrode, contact_resistivity=wear * skin.electrode.contact_resistivity)
    skin = replace(skin, electrode=electrode)
    return _pressed(skin) if world == "pressed" else _discs(skin, 1.0) if same_mesh else _discs(skin)


@lru_cache(maxsize=20_000)
def touched(world: str, layout: str, contacts: Contacts, wear: float = 1.0, same_mesh: bool = False) -> Floats:
    """Transfer resistances under contacts, kept for the next noise level, seed or method; see `sheet`."""
    resistance = sheet(world, layout, wear, same_mesh).touched(contacts)
    resistance.setflags(write=False)
    return resistance


def voltages(resistance: Floats, pattern: DrivePattern, currents: float | Floats = CURRENT) -> Floats:
    """Voltages (n_meas,) of a pattern from transfer resistances (n_elec, n_elec) in ohms, and currents (n_inj,) in
    amperes (V)."""
    a, b, c, d = pattern.quadruples.T
    volts = resistance[a, c] - resistance[a, d] - resistance[b, c] + resistance[b, d]
    return np.asarray(np.broadcast_to(currents, pattern.n_inj)[pattern.measurements[:, 0]] * volts)


@lru_cache(maxsize=8)
def full_scale(world: str) -> float:
    """The voltage that noise refers to: the largest of the 12B adjacent scan on the untouched sheet of a world (V)."""
    base = adjacent([Skin.load(LAYOUTS["grid"]).electrodes.rings[0]])
    return float(np.abs(voltages(sheet(world, "grid").untouched, base)).max())


def noise_volts(world: str, decibels: float) -> float:
    """Standard deviation of one voltage (V) at a noise level in decibels below `full_scale`.

    Raises:
        OhmskinError: If the level is not finite or beyond 0 to 200 dB.
    """
    if not (np.isfinite(decibels) and 0 <= decibels <= 200):
        raise OhmskinError(f"noise level is {decibels} dB; it must be 0 to 200 dB below the largest voltage")
    return full_scale(world) * 10 ** (-decibels / 20)


def contact(world: str, x: float, y: float, radius: float | None = None, strength: float | None = None) -> Shape:
    """A contact of a world at (x, y) in metres.

    Args:
        world: One of `WORLDS`.
        x, y: Its centre (m).
        radius: Its radius (m); that of `CONTACT_RADIUS` unless given.
        strength: Relative change of conductivity, or pressure (Pa) on the twin; of `CONTACT_STRENGTH` unless given.
    """
    radius = CONTACT_RADIUS[world] if radius is None else radius
    return disc(x, y, radius, CONTACT_STRENGTH[world] if strength is None else strength)


def described(levels: Sequence[float]) -> list[tuple[str, str, str, str]]:
    """A row for each world: its name, its usual contact, its largest 12B voltage, and the noise at each level (dB)."""
    rows = []
    for world, name in WORLD_NAMES.items():
        strength = CONTACT_STRENGTH[world]
        amount = f"+{100 * strength:g} %" if world == "discs" else f"{strength / 1e3:g} kPa"
        noise = " / ".join(f"{1e6 * noise_volts(world, level):.0f} µV at {level:g} dB" for level in levels)
        largest = f"{1e3 * full_scale(world):.1f} mV"
        rows.append((name, f"{1e3 * CONTACT_RADIUS[world]:g} mm, {amount}", largest, noise))
    return rows
