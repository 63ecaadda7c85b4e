"""
Stop when touched
=================

Stop a robot arm when it is touched. Run in two terminals::

    ohmskin live --publish shm
    python examples/stop_on_touch.py

An imaginary arm swings at 100 steps a second. It stops when the skin is touched, and as well when the skin has been
silent for 0.1 s, whatever the reason. It goes on when it is free again. Give it an address
and a number of seconds to look at another skin (``shm:NAME``, ``zenoh:NAME@tcp/HOST:PORT``) or to end.
"""

# sphinx_gallery_thumbnail_path = 'images/robot.png'
import sys
import time

from ohmskin.client import Client

STEP, OLDEST = 0.01, 0.1  # s


def main(address: str = "shm:skin", seconds: float = float("inf")) -> None:
    angle, moving = 0.0, False
    end = due = time.monotonic()
    end += seconds
    with Client(address) as skin:
        while time.monotonic() < end:
            newest = skin.newest()  # at once, whatever the skin does
            silent = newest is None or newest.age > OLDEST
            free = newest is not None and not silent and not newest.contacts
            if free != moving:
                moving = free
                touched = (
                    f"touched at {newest.contacts[0].position}"
                    if newest and newest.contacts and not silent
                    else "the skin is silent"
                )
                print("moving" if moving else f"stopped at {angle:.2f} rad: {touched}", flush=True)
            angle += 0.5 * STEP if moving else 0.0
            due += STEP
            time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main(*sys.argv[1:2], *map(float, sys.argv[2:3]))
