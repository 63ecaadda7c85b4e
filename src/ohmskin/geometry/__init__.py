"""Where things are: domains, meshes, electrode layouts, rasters."""

from ohmskin.geometry.domain import Disc, Domain, Rectangle
from ohmskin.geometry.electrodes import Electrodes
from ohmskin.geometry.mesh import Mesh
from ohmskin.geometry.meshing import mesh_domain
from ohmskin.geometry.raster import Raster

__all__ = ["Disc", "Domain", "Electrodes", "Mesh", "Raster", "Rectangle", "mesh_domain"]
