"""Regions of an image: threshold segmentation (paper, eq. 6), connected parts, and the elements at their middle."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from ohmskin.arrays import Floats, Ints, Shorts, Singles
from ohmskin.geometry import Cells
from ohmskin.geometry.periodic import folded, shortest


@dataclass(frozen=True)
class Region:
    """A connected part of an image above the threshold.

    Args:
        elements: (n,) numbers of its cells.
        centroid: (2,) centroid weighted by image value and area (m).
        anchors: (3, 2) centroids of the three cells closest to it (m), from which eq. (7) chooses the drive.
        peak: Largest image value in it (1).
        peak_element: The cell that holds it.
    """

    elements: Ints
    centroid: Floats
    anchors: Floats
    peak: float
    peak_element: int


def find_regions(values: Floats, cells: Cells, threshold: float, dip: float = 1.0) -> list[Region]:
    """The regions above `threshold`, strongest first.

    Args:
        values: Image (n_elem,).
        cells: Its mesh, or the pixels it is made of.
        threshold: gamma_0 of eq. (6) (1).
        dip: Two peaks of one connected region count as two where the saddle between them lies at least this share below
            the lower one. 1 never splits, exactly as eq. (6).
    """
    labels = label_peaks(values, cells.neighbours, threshold, dip)
    regions = []
    for number in range(int(labels.max(initial=-1)) + 1):
        elements = np.flatnonzero(labels == number)
        mass = values[elements] * cells.measures[elements]
        centroid = middle(cells, elements, mass)
        anchors = cells.centroids[cells.closest_elements(centroid[None], 3)[0]]
        peak_element = int(elements[np.argmax(values[elements])])
        regions.append(Region(elements, centroid, anchors, float(values[peak_element]), peak_element))
    return regions


def middle(cells: Cells, chosen: Ints, mass: Floats) -> Floats:
    """The centroid (2 or 3,) of some cells weighted by mass (n,), in metres; of a closed band, of the shorter arc."""
    places = cells.centroids[chosen]
    if not cells.period:
        return np.asarray(mass @ places / mass.sum())
    first = places[np.abs(mass).argmax()]
    return folded(first + mass @ shortest(places - first, cells.period) / mass.sum(), cells.period)


def label_peaks(values: Floats, neighbours: Ints, threshold: float, dip: float) -> Shorts:
    """Label (n_elem,) each element above `threshold` with its peak, 0 the highest peak; -1 below the threshold.

    Two regions that meet become one unless the meeting point lies `dip` below both peaks (their persistence).

    Args:
        values: (n_elem,) image.
        neighbours: (n_elem, n_facets) elements that share a facet with each, -1 where there is none.
        threshold: Value that an element must exceed (1).
        dip: Depth between two peaks from which on they are two (1).
    """
    above = np.flatnonzero(values > threshold)
    order = above[np.argsort(-values[above], kind="stable")][::-1].copy()
    parent, labels = np.empty((2, len(values)), np.int32)
    join_peaks(values.astype(np.float32), neighbours.astype(np.int32), order, dip, parent, labels)
    return labels


@njit(cache=True, nogil=True)
def join_peaks(values: Singles, neighbours: Shorts, order: Ints, dip: float, parent: Shorts, labels: Shorts) -> int:
    """`label_peaks` of the elements `order`, the highest last, into `labels`; `parent` is memory. How many peaks.

    Elements are visited from the highest down and join the region of a higher neighbour.
    """
    labels[:] = -1
    parent[:] = -1
    for at in range(len(order) - 1, -1, -1):
        e = order[at]
        root = -1
        for k in range(neighbours.shape[1]):
            other = neighbours[e, k]
            if other < 0 or parent[other] < 0:
                continue
            while parent[other] != other:
                parent[other] = parent[parent[other]]
                other = parent[other]
            if root < 0:
                root = other
            elif other != root:
                high, low = (root, other) if values[root] >= values[other] else (other, root)
                if values[e] > (1.0 - dip) * values[low]:
                    parent[low] = high
                root = high
        parent[e] = e if root < 0 else root
    count = 0
    for at in range(len(order) - 1, -1, -1):
        root = order[at]
        while parent[root] != root:
            root = parent[root]
        if labels[root] < 0:
            labels[root] = count
            count += 1
        labels[order[at]] = labels[root]
    return count
