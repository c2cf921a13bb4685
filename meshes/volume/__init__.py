"""From a CT or MR volume, or a label map, to a surface.

World coordinates are RAS (x to the patient's right, y to the front, z up) in metres, whatever the
frame and unit of the file. Where a file does not give the patient's orientation, `Volume.frame` is
None and `Volume.notes` says so.
"""

from meshes.volume.files import FORMATS, read
from meshes.volume.grid import MOST_BYTES, MOST_VOXELS, Volume
from meshes.volume.labels import MIDDLE, describe_values, one_label
from meshes.volume.surfaces import MOST_TRIANGLES, surface

__all__ = [
    "FORMATS",
    "MIDDLE",
    "MOST_BYTES",
    "MOST_TRIANGLES",
    "MOST_VOXELS",
    "Volume",
    "describe_values",
    "one_label",
    "read",
    "surface",
]
