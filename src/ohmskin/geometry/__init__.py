"""Geometry: domains, charts, meshes, cells of an image, electrode layouts, rasters."""

from ohmskin.geometry.band import Band
from ohmskin.geometry.cells import Cells
from ohmskin.geometry.chart import Chart, FlatChart, RevolutionChart
from ohmskin.geometry.domain import Disc, Domain, Rectangle
from ohmskin.geometry.electrodes import ElectrodeKind, Electrodes
from ohmskin.geometry.files import read_groups, read_mesh, write_mesh
from ohmskin.geometry.flatten import MeshChart, flat_patch
from ohmskin.geometry.graded import mesh_graded, mesh_surface
from ohmskin.geometry.mesh import Mesh
from ohmskin.geometry.meshing import electrode_points, kept_mesh, mesh_domain
from ohmskin.geometry.polygon import Polygon
from ohmskin.geometry.raster import Raster
from ohmskin.geometry.thick import thicken

__all__ = [
    "Band",
    "Cells",
    "Chart",
    "Disc",
    "Domain",
    "ElectrodeKind",
    "Electrodes",
    "FlatChart",
    "Mesh",
    "MeshChart",
    "Polygon",
    "Raster",
    "Rectangle",
    "RevolutionChart",
    "electrode_points",
    "flat_patch",
    "kept_mesh",
    "mesh_domain",
    "mesh_graded",
    "mesh_surface",
    "read_groups",
    "read_mesh",
    "thicken",
    "write_mesh",
]
