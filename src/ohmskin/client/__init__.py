"""The newest contacts of a skin or a robot, for a control loop in another process.

    from ohmskin.client import Client

    with Client() as skin:
        while True:
            felt = skin.newest()
            if felt is None or felt.age > 0.1 or felt.contacts:
                stop()

Imports the standard library only.
"""

from ohmskin.client.board import Board, BoardReader
from ohmskin.client.client import Client
from ohmskin.client.commands import Commands
from ohmskin.client.contacts import Contacts, Patch, PatchState, PlacedContact
from ohmskin.client.joints import JointStates

__all__ = [
    "Board",
    "BoardReader",
    "Client",
    "Commands",
    "Contacts",
    "JointStates",
    "Patch",
    "PatchState",
    "PlacedContact",
]
