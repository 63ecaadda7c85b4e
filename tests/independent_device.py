"""A device written from docs/protocol.md alone, with physics of its own: nothing of ohmskin is imported here.

The sheet is a square lattice of resistors, uneven, with electrodes off their places and unlike contact resistances. A
touch shorts the lattice through small round patches in a hexagonal lattice, which know nothing of the discs, meshes and
patches of ohmskin.
"""

import math
import socket
import struct
import threading
import zlib

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

SIDE, NODES, CONDUCTIVITY, CONTACT = 0.2, 101, 1.83e-3, 3.5  # m, along an edge, S, ohm
RIM = [(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 2), (3, 3), (2, 3), (1, 3), (0, 3), (0, 2), (0, 1)]
ELECTRODES = np.array([*RIM, (1, 1), (2, 1), (2, 2), (1, 2)]) * SIDE / 3
SOURCE, SERIES, FULL_SCALE, SETTLE, CONVERSION = 5.0, 350.0, 5.0, 1e-4, 2e-5  # V, ohm, V, s, s
PITCH, PATCH, LAYER = 8e-3, 3.5e-3, 3000.0  # m, m, S/m2 at 20 kPa


class Sheet:
    """Resistances between electrodes, as a touched lattice has them."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        x, y = np.meshgrid(*[np.linspace(0, SIDE, NODES)] * 2, indexing="ij")
        self._nodes = np.column_stack([x.ravel(), y.ravel()])
        waves = np.column_stack([rng.uniform(0, 1.5, (3, 2)) * 2 * np.pi / SIDE, rng.uniform(0, 6, 3)])
        self._sheet = CONDUCTIVITY * np.exp(0.03 * sum(np.sin(self._nodes @ wave[:2] + wave[2]) for wave in waves))
        at = np.clip(ELECTRODES + 5e-4 * rng.normal(size=(16, 2)), 0, SIDE)
        self._under = [self._near(place, 3e-3) for place in at]
        self._contact = 1 / (CONTACT * np.exp(0.15 * rng.normal(size=16)))
        rows = np.arange(-1, int(SIDE / (PITCH * math.sqrt(0.75))) + 2)
        lattice = [(PITCH * (k + (row % 2) / 2), PITCH * math.sqrt(0.75) * row) for row in rows for k in range(-1, 27)]
        covers = [(place, cover) for place in lattice if len(cover := self._near(place, PATCH))]
        self._places, self._patches = np.array([place for place, _ in covers]), [cover for _, cover in covers]
        self._area = (SIDE / (NODES - 1)) ** 2
        self._solved = dict[tuple, np.ndarray]()
        self.touches: dict[int, tuple[float, float, float]] = {}
        self.touch({})

    def _near(self, place: object, radius: float) -> np.ndarray:
        x, y = np.asarray(place)
        low, high = np.searchsorted(self._nodes[::NODES, 0], (x - 1.01 * radius, x + 1.01 * radius)) * NODES
        near = (self._nodes[low:high, 0] - x) ** 2 + (self._nodes[low:high, 1] - y) ** 2 <= radius**2
        return low + np.flatnonzero(near)

    def warm(self, factor: float) -> None:
        """Let all of the sheet conduct that many times as well."""
        self._sheet *= factor
        self._changed()

    def drift(self, change: float, wave: tuple[float, float]) -> None:
        """Let the sheet conduct better by as much as a share, in waves over it (rad/m)."""
        self._sheet *= np.exp(change * np.sin(self._nodes @ np.asarray(wave)))
        self._changed()

    def degrade(self, electrode: int, factor: float) -> None:
        """Let the contact of an electrode have that many times its resistance."""
        self._contact[electrode] /= factor
        self._changed()

    def exchange(self, one: int, other: int) -> None:
        """Let the wires of two electrodes be exchanged."""
        self._under[one], self._under[other] = self._under[other], self._under[one]
        self._contact[[one, other]] = self._contact[[other, one]]
        self._changed()

    def _changed(self) -> None:
        self._solved.clear()
        self.touch(self.touches)

    def touch(self, touches: dict[int, tuple[float, float, float]]) -> None:
        """Touch at x, y (m) with a pressure (Pa) over 6 mm; each in place of those before."""
        self.touches = touches
        if (key := tuple(touches.items())) not in self._solved:
            self._solved[key] = self._solve()
        self.potentials = self._solved[key]  # of each electrode, by a current into each (ohm)

    def _solve(self) -> np.ndarray:
        index, sheet = np.arange(NODES**2).reshape(NODES, NODES), self._sheet.reshape(NODES, NODES)
        ends, values = [], []
        for near, far in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
            along = 2 * sheet[near] * sheet[far] / (sheet[near] + sheet[far])
            edge = np.s_[:, [0, -1]] if near == np.s_[:-1] else np.s_[[0, -1], :]
            along[edge] /= 2
            ends.append((index[near].ravel(), index[far].ravel()))
            values.append(along.ravel())
        count = NODES**2 + 16
        for number, under in enumerate(self._under):
            ends.append((under, np.full(len(under), NODES**2 + number)))
            values.append(np.full(len(under), self._contact[number] / len(under)))
        touched = [np.hypot(*(self._places - touch[:2]).T) < 6e-3 + PATCH for touch in self.touches.values()]
        for patch in np.flatnonzero(np.any(touched, axis=0)):
            cover = self._patches[patch]
            layer = np.zeros(len(cover))
            for x, y, pressure in self.touches.values():
                inside = np.hypot(*(self._nodes[cover] - (x, y)).T) < 6e-3
                layer += inside * LAYER * (pressure / 2e4) ** 0.8 * self._area
            if np.count_nonzero(layer) > 1:
                ends.append((cover[layer > 0], np.full(np.count_nonzero(layer), count)))
                values.append(layer[layer > 0])
                count += 1
        (one, other), value = (np.concatenate([pair[k] for pair in ends]) for k in (0, 1)), np.concatenate(values)
        whole = sp.coo_array((np.tile(-value, 2), (np.r_[one, other], np.r_[other, one])), (count, count)).tocsc()
        ground = np.zeros(count)
        ground[0] = 1e-9
        whole = (whole + sp.diags_array(ground - whole.sum(axis=1))).tocsc()
        into = np.zeros((count, 16))
        into[NODES**2 : NODES**2 + 16] = np.eye(16) - 1 / 16
        # few columns at a time, as a lattice has: a third less time than as SuperLU comes
        factors = splu(whole, permc_spec="MMD_AT_PLUS_A", relax=1, panel_size=4, options={"SymmetricMode": True})
        solved: np.ndarray = factors.solve(into)
        return solved[NODES**2 : NODES**2 + 16]


class IndependentDevice:
    """Serves the sheet over TCP on a port of its own.

    `opened` are electrodes whose wire is off; `odd` says what is wrong with the next scans, one word for each;
    `then` are touches from after the next scan on; `touched` numbers the scans that were touched; `hum` is of 50 Hz, on
    all voltages (V).
    """

    def __init__(self, seed: int, noise: float = 1e-4) -> None:
        self.sheet, self.noise, self._rng = Sheet(seed), noise, np.random.default_rng(seed + 100)
        self._gains = 1 + 1e-3 * self._rng.normal(size=(16, 16))
        self.opened, self.odd = set[int](), list[str]()
        self.then: dict[int, tuple[float, float, float]] | None = None
        self.touched = set[int]()
        self._clock, self._number, self.hum = 0.0, 0, 0.0
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        """No further connections."""
        self._server.close()

    def _serve(self) -> None:
        while True:
            try:
                line, _ = self._server.accept()
            except OSError:
                return
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._session, args=(line,), daemon=True).start()

    def _session(self, line: socket.socket) -> None:
        slots: dict[int, tuple[int, np.ndarray, np.ndarray]] = {}
        rest = b""
        with line:
            while data := line.recv(65536):
                *packets, rest = (rest + data).split(b"\0")
                for packet in packets:
                    whole = _unstuffed(packet)
                    if len(whole) < 8 or zlib.crc32(whole[:-4]) != struct.unpack("<I", whole[-4:])[0]:
                        continue
                    _, kind, sequence = struct.unpack_from("<BBH", whole)
                    kind, payload = self._answer(kind, whole[4:-4], slots)
                    reply = struct.pack("<BBH", 1, kind, sequence) + payload
                    line.sendall(_stuffed(reply + struct.pack("<I", zlib.crc32(reply))) + b"\0")

    def _answer(self, kind: int, payload: bytes, slots: dict) -> tuple[int, bytes]:
        if kind == 1:
            slots.clear()
            numbers = (SOURCE, FULL_SCALE, SETTLE, CONVERSION, 16, 256, 4096, 8, 1, 0, 0)
            return 0x81, struct.pack("<IIIffffHHHBBBB", 7, 1, 2 | 4 | 8, *numbers) + b"independent"
        if kind == 2:
            slot, n_inj, n_meas = struct.unpack_from("<HHH", payload)
            injections = np.frombuffer(payload, "<u2", 2 * n_inj, 6).reshape(-1, 2).astype(int)
            measured = np.frombuffer(payload, "<u2", 3 * n_meas, 6 + 4 * n_inj).reshape(-1, 3).astype(int)
            slots[slot] = zlib.crc32(payload[2:]), injections, measured
            return 0x82, struct.pack("<I", slots[slot][0])
        if kind == 3:
            digest, slot = struct.unpack("<IH", payload)
            if slot not in slots or slots[slot][0] != digest:
                return 0xFF, struct.pack("<H", 6 if slot not in slots else 7) + b"send the pattern again"
            odd = self.odd.pop(0) if self.odd else ""
            if odd == "failed":
                return 0xFF, struct.pack("<H", 10) + b"converter failed"
            scanned = b"\1\2" if odd == "cut" else self._frame(*slots[slot], odd)
            if self.then is not None:
                self.sheet.touch(self.then)
                self.then = None
            return 0x83, scanned
        return 0xFF, struct.pack("<H", 8) + b"not here"

    def _frame(self, digest: int, injections: np.ndarray, measured: np.ndarray, odd: str) -> bytes:
        potentials, rng = self.sheet.potentials, self._rng
        source, sink = injections.T
        one, other = potentials[:, source] - potentials[:, sink], np.arange(len(source))
        current = SOURCE / (SERIES + one[source, other] - one[sink, other])
        current = np.where(np.isin(injections, [*self.opened]).any(axis=1), 0.0, current)
        injection, plus, minus = measured.T
        volts = current[injection] * (one[plus, injection] - one[minus, injection])
        volts = volts + self.noise * rng.normal(size=len(volts))
        when = self._clock + SETTLE * (injection + 1) + CONVERSION * np.arange(len(volts))
        volts += self.hum * np.sin(2 * np.pi * 50 * when)
        loose = np.isin(measured[:, 1:], [*self.opened]).any(axis=1)
        volts = np.where(loose, 0.3 * rng.normal(size=len(volts)), volts)  # a wire that is off hears all around it
        told = current * self._gains[source, sink] * (1 + 1e-5 * rng.normal(size=len(current)))
        if odd == "spike":
            volts[rng.integers(len(volts), size=5)] += 0.3
        if odd in ("nan", "zero"):
            volts, told = np.full(len(volts), np.nan if odd == "nan" else 0.0), told * (odd == "nan")
        self._clock += SETTLE * len(source) + CONVERSION * len(volts) + 1e-3
        self._number += 1
        if self.sheet.touches:
            self.touched.add(self._number)
        head = struct.pack("<IIQIHH", digest, self._number, int(1e6 * self._clock), 0, len(source), len(volts))
        return head + told.astype("<f4").tobytes() + volts.astype("<f4").tobytes()


def _stuffed(data: bytes) -> bytes:
    out = bytearray()
    for run in data.split(b"\0"):
        start = 0
        while len(run) - start >= 254:
            out += b"\xff" + run[start : start + 254]
            start += 254
        out += bytes([len(run) - start + 1]) + run[start:]
    return bytes(out)


def _unstuffed(data: bytes) -> bytes:
    out, at = bytearray(), 0
    while at < len(data):
        code = data[at]
        out += data[at + 1 : at + code]
        at += code
        if code < 255 and at < len(data):
            out.append(0)
    return bytes(out)
