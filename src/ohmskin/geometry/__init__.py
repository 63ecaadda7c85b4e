"""Where things are: domains, meshes, electrode layouts, rasters."""

from ohmskin.geometry.domain import Disc, Domain, Rectangle
from ohmskin.geometry.electrodes import ElectrodeKind, Electrodes
from ohmskin.geometry.mesh import Mesh
from ohmskin.geometry.meshing import mesh_domain
from ohmskin.geometry.polygon import Polygon
from ohmskin.geometry.raster import Raster

__all__ = ["Disc", "Domain", "ElectrodeKind", "Electrodes", "Mesh", "Polygon", "Raster", "Rectangle", "mesh_domain"]
