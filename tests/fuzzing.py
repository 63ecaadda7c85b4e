"""Valid files and streams, made by our own writers, with a field or some bytes changed: whoever reads them reads them,
or says one clear word. `python tests/fuzzing.py toml --count 10000` tries so many of a kind and shows what failed.

Each case runs in a child process with bounds on memory and time. It follows from kind, seed and number alone.
"""

import argparse
import faulthandler
import json
import logging
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_CACHE_DIR", os.path.abspath(f"{__file__}/../../.pytest_cache/numba"))

MEMORY = 2**30  # bytes beside what is there before the first case
_START = 300.0  # s that a child may take to begin
_SHOWN = 40  # failures that are kept

NUMBERS = (0, 1, 2, 3, 7, 16, 127, 128, 255, 256, 4096, 32767, 32768, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**53)
FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-300, 1e-30, 1e-9, 1e9, 3e38, 1e300, float("inf"), float("-inf"), float("nan"))


class Kind(Protocol):
    """One kind of input: how a case of it is made and who reads it."""

    allowed: tuple[type[Exception], ...]  # errors that are a clear word

    def make(self, rng: random.Random) -> bytes:
        """A valid one, changed."""

    def use(self, content: bytes, rng: random.Random) -> None:
        """Read it as a user would."""


def spoilt(content: bytes, rng: random.Random) -> bytes:
    """Some bytes flipped, overwritten, cut, doubled, left out or exchanged."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        if not data:
            break
        at, width = rng.randrange(len(data)), rng.choice((1, 2, 4, 8, 30, 300))
        match rng.randrange(8):
            case 0:
                data[at] ^= 1 << rng.randrange(8)
            case 1:
                data[at] = rng.randrange(256)
            case 2:
                size = rng.choice((1, 2, 4, 8))
                data[at : at + size] = (rng.choice(NUMBERS) % 256**size).to_bytes(size, rng.choice(("little", "big")))
            case 3:
                data[at : at + width] = rng.choice((b"\0", b"\xff", b"\x7f", rng.randbytes(1))) * width
            case 4:
                del data[at:]
            case 5:
                del data[at : at + width]
            case 6:
                data[at:at] = data[max(0, at - width) : at]
            case 7:
                other = rng.randrange(len(data))
                data[at : at + width] = data[other : other + width]
    return bytes(data)


@dataclass
class Outcome:
    """What became of the cases of one kind."""

    cases: int = 0
    read: int = 0
    refused: int = 0
    failures: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)  # failures by what they say last
    peak: int = 0  # bytes of memory beside what was there before the first case

    def failed(self, number: int, words: str) -> None:
        key = words.strip().splitlines()[-1][:160]
        self.counts[key] += 1
        if self.counts[key] <= 2 and len(self.failures) < _SHOWN:
            self.failures.append(f"case {number}: {words}")


def tried(kind: str, seed: int, count: int, seconds: float = float("inf"), first: int = 0) -> Outcome:
    """Try cases of a kind, as many as there is time for; a child that dies is replaced."""
    return all_tried([kind], seed, count, seconds, first)[kind]


def all_tried(
    kinds: Sequence[str], seed: int, count: int, seconds: float = float("inf"), first: int = 0
) -> dict[str, Outcome]:
    """Likewise of several kinds, in one child as long as it lives; the first begins at `first`, the others at 0."""
    outcomes, end = {kind: Outcome() for kind in kinds}, time.monotonic() + seconds
    ahead, number = list(kinds), first
    while ahead and time.monotonic() < end:
        number = _child(ahead, seed, number, first + count, end, outcomes)
        if number >= first + count:
            del ahead[0]
            number = 0
    return outcomes


def _child(ahead: list[str], seed: int, number: int, last: int, end: float, outcomes: dict[str, Outcome]) -> int:
    """Let a child try the kinds ahead, of the first one cases from `number` on; what it ends with stays ahead."""
    left = 1e9 if end == float("inf") else end - time.monotonic()
    command = [sys.executable, __file__, ",".join(ahead), "--seed", str(seed), "--first", str(number), "--count"]
    outcome = outcomes[ahead[0]]
    with tempfile.TemporaryFile("w+") as errors:
        told = [*command, str(last - number), "--child", str(left)]
        child = subprocess.Popen(told, stdout=subprocess.PIPE, stderr=errors, text=True)
        assert child.stdout is not None
        running: int | None = None
        with child.stdout:
            for line in child.stdout:
                said = json.loads(line)
                if "kind" in said:
                    del ahead[: ahead.index(said["kind"])]
                    outcome, number = outcomes[ahead[0]], said["first"]
                    continue
                outcome.peak = max(outcome.peak, said.get("peak", 0))
                if "begins" in said:
                    running = said["begins"]
                    continue
                running, number = None, said["case"] + 1
                if "read" not in said:
                    continue
                outcome.cases += 1
                if said["failed"]:
                    outcome.failed(said["case"], said["failed"])
                else:
                    outcome.read += said["read"]
                    outcome.refused += not said["read"]
        status = child.wait()
        errors.seek(0)
        words = errors.read()[:6000]
    if running is not None:
        outcome.cases, number = outcome.cases + 1, running + 1
        hung = words.startswith("Timeout")
        places = [line.strip() for line in words.splitlines() if "/ohmskin/" in line]
        what = f"took more than {_limit():g} s" if hung else f"ended the process with status {status}"
        outcome.failed(running, f"{words}\n{what}: {(places or ['nowhere'])[0]}")
    elif status:
        raise RuntimeError(f"the harness failed: {words}")
    return number


def _dice(name: str, seed: int, number: int) -> random.Random:
    return random.Random(f"{name}/{seed}/{number}")


def _limit() -> float:
    """How long a case may take (s)."""
    return float(os.environ.get("FUZZ_SECONDS", "10"))


def _kind(name: str, folder: Path) -> Kind:
    if name == "broken":
        return Broken(folder)
    from fuzz_files import FILES
    from fuzz_streams import STREAMS
    from fuzz_texts import TEXTS

    return (FILES | TEXTS | STREAMS)[name](folder)


def _cases(kind: Kind, name: str, seed: int, numbers: range) -> Iterator[dict[str, Any]]:
    for number in numbers:
        rng = _dice(name, seed, number)
        try:
            content = kind.make(rng)
        except Exception:  # noqa: BLE001  a change that cannot be written, such as one too large, is no case
            content = None
        yield {"begins": number}
        if content is None:
            yield {"case": number}
            continue
        failed, read = "", False
        faulthandler.dump_traceback_later(_limit(), exit=True)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                kind.use(content, rng)
            read = True
        except kind.allowed as error:
            failed = "" if str(error).strip() and len(str(error)) < 3000 else f"says {str(error)[:3000]!r}"
        except Exception:  # noqa: BLE001  that is what is looked for
            failed = traceback.format_exc(limit=-12)
        faulthandler.cancel_dump_traceback_later()
        yield {"case": number, "failed": failed, "read": read, "peak": _peak()}


class Broken:
    """Ends in each of the ways that are looked for."""

    allowed = (ValueError,)

    def __init__(self, _: Path) -> None:
        pass

    def make(self, rng: random.Random) -> bytes:
        return bytes([rng.randrange(8)])

    def use(self, content: bytes, rng: random.Random) -> None:
        match content[0]:
            case 0:
                raise ValueError("one clear word")
            case 1:
                raise KeyError("a traceback")
            case 2:
                bytearray(2 * MEMORY)
            case 3:
                time.sleep(1000)
            case 4:
                os._exit(3)
            case 5:
                warnings.warn("on stderr", stacklevel=2)
            case 6:
                raise ValueError


def _memory(name: str) -> int:
    text = Path("/proc/self/status").read_text()
    return next(int(line.split()[1]) * 1024 for line in text.splitlines() if line.startswith(name))


_BEFORE: list[int] = []


def _peak() -> int:
    return _memory("VmHWM") - _BEFORE[0]


def _serve(names: Sequence[str], seed: int, numbers: range, seconds: float) -> None:
    end = time.monotonic() + seconds
    logging.disable()
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            faulthandler.dump_traceback_later(_START, exit=True)
            resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            kind = _kind(name, Path(folder))
            faulthandler.cancel_dump_traceback_later()
            Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here on
            _BEFORE[:] = [_memory("VmHWM")]
            resource.setrlimit(resource.RLIMIT_AS, (_memory("VmSize") + MEMORY, resource.RLIM_INFINITY))
            resource.setrlimit(resource.RLIMIT_FSIZE, (MEMORY, resource.RLIM_INFINITY))
            own = numbers if name == names[0] else range(numbers.stop)
            print(json.dumps({"kind": name, "first": own.start}), file=out, flush=True)
            for said in _cases(kind, name, seed, own):
                print(json.dumps(said), file=out, flush=True)
                if "case" in said and time.monotonic() > end:
                    break
        os.chdir("/")
    out.close()
    os._exit(0)  # threads of a device that hangs must not keep it


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--keep", type=Path, help="write the case FIRST to this file and end")
    parser.add_argument("--child", type=float, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.keep:
        with tempfile.TemporaryDirectory() as folder:
            kind = _kind(given.kind, Path(folder))
            given.keep.write_bytes(kind.make(_dice(given.kind, given.seed, given.first)))
        return
    if given.child is not None:
        _serve(given.kind.split(","), given.seed, range(given.first, given.first + given.count), given.child)
    outcome = tried(given.kind, given.seed, given.count, given.seconds, given.first)
    for words in outcome.failures:
        print(words, end="\n\n")
    for words, count in outcome.counts.most_common():
        print(f"{count:6d}  {words}")
    figures = f"{outcome.cases} cases, {outcome.read} read, {outcome.refused} refused"
    print(
        f"{given.kind}, seed {given.seed}: {figures}, {sum(outcome.counts.values())} failed; {outcome.peak >> 20} MiB"
    )


if __name__ == "__main__":
    main()
