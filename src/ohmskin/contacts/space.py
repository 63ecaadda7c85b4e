"""From the flat map of a skin to the skin itself: sizes on it, and places in a frame of the robot."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ohmskin.client.contacts import Patch, PlacedContact
from ohmskin.contacts.finder import Contact
from ohmskin.geometry import Chart


def on_skin(contacts: Sequence[Contact], chart: Chart) -> tuple[Contact, ...]:
    """`contacts` on a map (`chart`) as they are on the skin: areas and radii are larger where the map's scale is."""
    if chart.flat or not contacts:
        return tuple(contacts)
    scales = chart.scale([contact.position for contact in contacts]).tolist()
    return tuple(
        replace(
            contact,
            extent=scale**2 * contact.extent,
            strength=scale**2 * contact.strength,
            radius=None if contact.radius is None else scale * contact.radius,
        )
        for contact, scale in zip(contacts, scales, strict=True)
    )


def in_frame(contacts: Sequence[Contact], chart: Chart, patch: Patch) -> list[PlacedContact]:
    """`contacts` on the map (`chart`) of a patch's skin, in the frame of the `patch`."""
    if not contacts:
        return []
    places = np.array([contact.position for contact in contacts])
    around = chart.points(places).tolist(), chart.frames(places).tolist(), chart.scale(places).tolist()
    found = []
    for contact, point, axes, scale in zip(contacts, *around, strict=True):
        here = replace(contact, position=(0.0, 0.0))
        if contact.velocity is not None:
            x, y = contact.velocity
            here = replace(here, velocity=(scale * x, scale * y))
        if contact.covariance is not None:
            (xx, xy), (_, yy) = scale**2 * np.array(contact.covariance)
            here = replace(here, covariance=((float(xx), float(xy)), (float(xy), float(yy))))
        found.append(patch.at(point, axes).contact(here))
    return found
